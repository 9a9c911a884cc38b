"""What a factory may read of the folders that its code lies in."""

import pytest

from minitouch_bench.errors import IsolationError, PolicyLoadError
from minitouch_bench.policies.policy import IsolationOptions, zero_observation
from minitouch_bench.policies.policy_process import PolicyProcess
from minitouch_bench.policies.sandbox import factory_paths
from minitouch_bench.policies.sources import parse_source

READER = """
import os
import data.deep
import numpy as np
NAMES = {names}
class Reader:
    def reset(self, seed, task):
        assert "reports" in os.listdir(".")
    def act(self, observation):
        found = []
        for name in NAMES:
            try:
                found.append(float(len(open(name).read())))
            except PermissionError:
                found.append(0.0)
        return np.array(found, np.float32)
"""
OPEN = ("data/numbers.txt", "reports/other/notes.txt")
CLOSED = (".env", "reports/run/run.json")


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A working directory with a factory, its data, a secret and a run."""
    for name in (*OPEN, *CLOSED, "reports/run/run.journal"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")
    (tmp_path / "data" / "deep.py").write_text("")
    (tmp_path / "reader.py").write_text(READER.format(names=(*OPEN, *CLOSED)))
    (tmp_path / "link").symlink_to(tmp_path / "reports" / "run")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_factory_reads_its_data_but_neither_its_run_nor_hidden_files(home):
    source = parse_source("reader:Reader")
    options = IsolationOptions(trust=True, private=str(home / "reports" / "run"))
    with PolicyProcess(source, options) as policy:
        policy.reset(0, "pushing")
        assert policy.act(zero_observation()).tolist() == [1.0, 1.0, 0.0, 0.0]


def test_a_factory_that_is_denied_a_file_is_told_what_it_may_read(home, tmp_path_factory):
    weights = tmp_path_factory.mktemp("elsewhere") / "weights.txt"
    weights.write_text("1")
    (home / "far.py").write_text(f"def make():\n    return open({str(weights)!r}).read()\n")
    source = parse_source("far:make")
    told = pytest.raises(PolicyLoadError, match=r"weights.txt.* PYTHONPATH only")
    with PolicyProcess(source, IsolationOptions(trust=True)) as policy, told:
        policy.reset(0, "pushing")


@pytest.mark.parametrize("run", ["reports/run", "reports", ".", ""])
def test_no_part_that_is_named_holds_the_run(home, run):
    (home / "run.journal").touch()
    private = str(home / run) if run else ""
    readable, listable = factory_paths("reader:Reader", private)
    assert str(home) in listable
    assert str(home) not in readable
    assert str(home / "link") not in readable
    assert str(home / ".env") not in readable
    assert str(home / "data") in readable
    assert (str(home / "reports") in readable) == (run in {".", ""})
    assert (str(home / "run.journal") in readable) == (run != ".")


@pytest.mark.parametrize("folder", ["/", "/etc"])
def test_a_factory_is_not_started_in_a_folder_of_the_system(monkeypatch, folder):
    monkeypatch.chdir(folder)
    with pytest.raises(IsolationError, match=f"in {folder}, .*\nRun the command in another"):
        factory_paths("reader:Reader")
