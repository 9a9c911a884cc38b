"""A curiosity of the user's: it goes on from its state, and runs only as it was trusted."""

import hashlib
import shutil
import sys
from dataclasses import replace

import pytest

from minitouch_bench.agents.config import read_recorded_config
from minitouch_bench.agents.training_directory import run_training
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.json_io import write_toml
from tests.agents.trainings import CONFIG, break_off, outcome
from tests.altered import ROOT
from tests.process_tree import run_python

EXAMPLE = ROOT / "docs" / "examples" / "curiosity" / "touch_counts.py"
OWN = replace(CONFIG, method="touch_counts:TouchCounts")
COMMAND = ("-m", "minitouch_bench", "train", "pushing", "--device", "cpu", "--config", "own.toml")


@pytest.fixture
def beside(tmp_path, monkeypatch):
    """A working directory with the example of the how-to page, which nothing has imported."""
    shutil.copy(EXAMPLE, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield tmp_path
    for name in ("touch_counts", "mine"):
        sys.modules.pop(name, None)


def test_the_page_s_example_trains_and_resumes_with_trust_and_the_same_file(beside):
    (beside / "own.toml").write_text(write_toml(OWN))
    refused = run_python(*COMMAND, code=2)
    assert "--trust" in refused.stderr
    assert "Traceback" not in refused.stderr
    assert run_python(*COMMAND, "--trust").stdout == "reports/training/pushing-TouchCounts-0\n"
    directory = beside / "reports" / "training" / "pushing-TouchCounts-0"
    recorded = read_recorded_config(directory / "config.toml")
    assert recorded.method_digest == hashlib.sha256(EXAMPLE.read_bytes()).hexdigest()

    again = beside / "again"
    break_off(again, 17, OWN, trust=True)
    with pytest.raises(UsageError, match="--trust"):
        run_training(OWN, again, resume=True, device="cpu")
    assert run_training(OWN, again, resume=True, device="cpu", trust=True)
    assert outcome(again) == outcome(directory)

    with (beside / "touch_counts.py").open("a") as file:
        file.write("# another file\n")
    with pytest.raises(RunDirectoryError, match="method_digest"):
        run_training(OWN, again, resume=True, device="cpu", trust=True)


MINE = """
import torch
from minitouch_bench.agents.curiosity import Curiosity, Errors

class Nothing(Curiosity):
    pass

class Wrong(Curiosity):
    def __init__(self, config, action_size):
        super().__init__(config)

    def errors(self, batch):
        return Errors(torch.ones(len(batch.touch), 1), torch.tensor(0.0))

class Raising(Wrong):
    def errors(self, batch):
        raise KeyError("it is missing")

class Leaving(Wrong):
    def errors(self, batch):
        raise SystemExit
"""


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("mine:Nothing", "errors"),
        ("mine:Errors", "subclass"),
        ("mine:Missing", "Missing"),
        ("nowhere:Class", "nowhere"),
        ("mine:Wrong", "(4, 1)"),
        ("mine:Leaving", "SystemExit"),
        ("leaving:Class", "SystemExit"),
        ("mine:Raising", "it is missing' (mine.py:17 in errors)"),
    ],
)
def test_a_faulty_class_is_named_in_one_line(name, words, beside):
    (beside / "mine.py").write_text(MINE)
    (beside / "leaving.py").write_text("raise SystemExit")
    with pytest.raises(UsageError) as refused:
        run_training(replace(CONFIG, method=name), beside / "run", device="cpu", trust=True)
    assert words in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1
