"""Looking at the runs of a leaderboard's row, which stay as they are."""

import pytest

from minitouch_bench.runs.run import read_run
from tests.commands.command import run
from tests.leaderboard.synthetic import make_row

PLACE = "results/hac/seed-0/table4"


@pytest.fixture
def root(tmp_path):
    make_row(tmp_path, "hac")
    return tmp_path


@pytest.mark.parametrize("path", [PLACE, f"{PLACE}/run.json.gz"])
def test_the_report_of_a_row_s_run_is_written_elsewhere(root, path):
    before = sorted((root / "results").rglob("*"))
    done = run("report", path, directory=root)
    assert done.code == 0, done.err
    assert sorted((root / "results").rglob("*")) == before
    assert (root / "reports/hac/seed-0/table4/report.html").exists()


@pytest.mark.parametrize("command", [("replay", PLACE, "pushing/1"), ("verify", PLACE)])
def test_a_run_without_actions_says_how_to_get_them(root, command):
    done = run(*command, directory=root)
    assert (done.code, done.out) == (6, "")
    assert "without its actions" in done.err
    assert "minitouch-bench evaluate" in done.err


def test_two_rows_are_compared_without_actions(root):
    make_row(root, "other", 0.5)
    done = run("compare", PLACE, "results/other/seed-0/table4", directory=root)
    assert done.code == 0, done.err
    assert "A is better" in done.out


@pytest.mark.parametrize("content", [b"", b"\x1f\x8b" + bytes(20), b"text"])
def test_a_damaged_file_is_named(root, content):
    (root / PLACE / "run.json.gz").write_bytes(content)
    run("report", PLACE, directory=root).refused(6, "run.json")


def test_a_packed_run_is_the_run(root):
    packed = read_run(root / PLACE)
    (root / "plain").mkdir()
    (root / "plain" / "run.json").write_bytes(packed.content)
    assert read_run(root / "plain").summary == packed.summary
