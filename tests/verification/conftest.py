import shutil
from pathlib import Path

import pytest

from minitouch_bench.evaluation.engine import ignore
from minitouch_bench.files import RUN_FILE, write_file
from minitouch_bench.reporting.report import write_views
from minitouch_bench.runs.run import run_json
from minitouch_bench.verification.replay_check import Findings, replay_run
from minitouch_bench.verification.static_check import check_run
from tests.evaluation.runs import request, run
from tests.leaderboard.browser import browser, started_browser  # noqa: F401

WANTED = request("scripted", ("pushing", "opening"), 2, exploration="scripted")


@pytest.fixture(scope="session")
def whole(tmp_path_factory) -> Path:
    """A finished run with all its files, which nobody may change."""
    directory = tmp_path_factory.mktemp("verified") / "run"
    done = run(WANTED, directory, workers=2)
    write_file(directory / RUN_FILE, run_json(done))
    write_views(done, directory)
    return directory


@pytest.fixture
def copy(whole, tmp_path) -> Path:
    """The same run, to be falsified."""
    return Path(shutil.copytree(whole, tmp_path / "run"))


def verify_run(run, engine, on_record=ignore):
    """Check a run, then replay it, as the command ``verify`` does."""
    problems = check_run(run)
    return Findings(problems) if problems else replay_run(run, engine, on_record)
