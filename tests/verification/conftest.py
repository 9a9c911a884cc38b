import json
import shutil
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from minitouch_bench.evaluation.rollout import EpisodeRunner
from minitouch_bench.files import ACTIONS_FILE, RUN_FILE, write_file
from minitouch_bench.reporting.views import write_report, write_tables
from minitouch_bench.runs.run import run_json
from tests.evaluation.runs import request, run

WANTED = request("scripted", ("pushing", "opening"), 2, exploration="scripted")


@pytest.fixture(scope="session")
def whole(tmp_path_factory) -> Path:
    """A finished run with all its files, which nobody may change."""
    directory = tmp_path_factory.mktemp("verified") / "run"
    done = run(WANTED, directory, workers=2)
    write_file(directory / RUN_FILE, run_json(done))
    write_tables(done, directory)
    write_report([done], directory)
    return directory


@pytest.fixture
def copy(whole, tmp_path) -> Path:
    """The same run, to be falsified."""
    return Path(shutil.copytree(whole, tmp_path / "run"))


class Here:
    """An engine without workers, which is quicker for a few episodes."""

    def run(self, source, specs):
        runner = EpisodeRunner(source)
        yield from map(runner.run, specs)
        runner.close()


def edit_document(directory: Path, change: Callable[[dict], object]) -> None:
    """Change ``run.json`` alone: the other files stay what they were."""
    file = directory / "run.json"
    document = json.loads(file.read_text())
    change(document)
    file.write_bytes(msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n")


def edit_actions(directory: Path, change: Callable[[dict], object]) -> None:
    file = directory / ACTIONS_FILE
    with np.load(file) as archive:
        actions = dict(archive)
    change(actions)
    np.savez_compressed(file, **actions)
