"""Looking at episodes, and at the runs of a leaderboard's row, which stay as they are."""

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


@pytest.fixture(scope="module")
def idle(tmp_path_factory):
    """A run of Pushing's first episode by the policy that does nothing."""
    directory = tmp_path_factory.mktemp("idle")
    episode = ("--episodes-from", "pushing/1", "--seed", 0)
    done = run("evaluate", "zero", *episode, "--output", directory / "run", directory=directory)
    assert done.code == 0, done.err
    return directory / "run"


def test_an_episode_of_two_runs_is_shown_on_one_time_axis(scripted, idle, tmp_path, browser):
    page = tmp_path / "both.html"
    ends = ("--beside", idle, "--output", page)
    done = run("replay", scripted[1], "pushing/1", *ends, directory=tmp_path)
    assert done.code == 0, done.err
    assert done.err.count("the same bits as recorded") == 2
    browser.open(page)
    curves = "[...document.querySelectorAll('.plot')[0].querySelectorAll('.curve')]"
    widths = browser.run(f"{curves}.map((one) => one.getBBox().width)")
    ticks = [read_run(place).find("pushing/1")[1].ticks for place in (scripted[1], idle)]
    assert widths[0] / widths[1] == pytest.approx(ticks[0] / ticks[1], rel=0.05)
    browser.press("End")
    now = browser.run("document.getElementById('now').textContent")
    steps = [len(read_run(place).actions_of("pushing/1")) for place in (scripted[1], idle)]
    for name, count in zip(("scripted", "zero"), steps, strict=True):
        assert f"{name}: step {count} of {count}" in now
    assert browser.messages == []


@pytest.mark.parametrize(
    ("words", "reason"),
    [(("--csv",), "leave --video and --csv out"), (("--output", "a.pdf"), ".html file")],
)
def test_two_runs_are_one_page_alone(scripted, idle, tmp_path, words, reason):
    command = ("replay", scripted[1], "pushing/1", "--beside", idle, *words)
    run(*command, directory=tmp_path).refused(2, reason)


def test_another_scene_is_refused(scripted, tmp_path):
    other = tmp_path / "other"
    words = ("--tasks", "pushing", "--episodes", 2, "--seed", 7, "--output", other)
    assert run("evaluate", "zero", *words, directory=tmp_path).code == 0
    done = run("replay", scripted[1], "pushing/1", "--beside", other, directory=tmp_path)
    done.refused(2, "not the same episode")
