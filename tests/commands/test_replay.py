"""Looking at the run of a submission, which stays as it is."""

import html
import re
from pathlib import Path

import pytest
from minitouch_bench.leaderboard.proof import ProofLevel
from minitouch_bench.leaderboard.validation import validate

from minitouch_bench.commands.report import report
from minitouch_bench.leaderboard.site import build_board
from minitouch_bench.runs.run import read_run
from tests.commands.command import run
from tests.leaderboard.synthetic import make_submission

RUN = Path("submissions/hac/seed-0/table4")


@pytest.fixture(scope="module")
def submission(tmp_path_factory):
    """A submission in a directory of submissions, which nobody may change."""
    return make_submission(tmp_path_factory.mktemp("looked-at") / "submissions")


@pytest.fixture
def inside(submission, monkeypatch):
    """Work where the submissions are; what lies in this one must be the same afterwards."""
    monkeypatch.chdir(submission.parents[1])
    before = sorted(submission.rglob("*"))
    yield submission
    assert sorted(submission.rglob("*")) == before
    assert validate(submission, trust_proofs=True).level is ProofLevel.VERIFIED  # of these bytes


def shortest(directory):
    """Return the name of the episode with the fewest steps."""
    row = min(read_run(directory).rows, key=lambda row: row.steps)
    return f"{row.task}/{row.index}"


@pytest.mark.parametrize("place", ["..", "seed-0/table4"])
def test_even_where_one_works_among_the_submissions(inside, monkeypatch, place):
    monkeypatch.chdir(inside / place)
    report([inside / "seed-0" / "table4"])
    assert (inside.parents[1] / "reports/hac/seed-0/table4/report.html").exists()


@pytest.mark.usefixtures("inside")
@pytest.mark.parametrize("run_path", [RUN, RUN / "run.json"])
def test_the_report_of_a_submission_s_run_is_written_elsewhere(run_path):
    report([run_path])
    written = Path("reports/hac/seed-0/table4").iterdir()
    assert {path.name for path in written} == {"report.html"}


def test_the_command_on_a_submission_s_page_shows_its_episode(inside):
    root = inside.parents[1]
    build_board(Path("submissions"), Path("board"))
    page = html.unescape(Path("board/submission/hac.html").read_text())
    (path,) = re.findall(r'"path":"([^"]*)"', page)
    done = run("replay", path, shortest(RUN), directory=root)
    assert done.out == f"reports/hac/seed-0/table4/replays/{shortest(RUN).replace('/', '-')}.html\n"
    assert "NOT the bits" in done.err  # nobody simulated these episodes
    assert "not the recorded episode" in (root / done.out.strip()).read_text()
