"""Looking at episodes, and at the runs of a leaderboard's row, which stay as they are."""

import pytest

from minitouch_bench.files import write_file
from minitouch_bench.runs.run import read_run
from tests.commands.command import run, succeed
from tests.leaderboard.synthetic import make_row

PLACE = "results/hac/seed-0/table4"


@pytest.fixture
def root(tmp_path):
    make_row(tmp_path, "hac")
    return tmp_path


@pytest.mark.parametrize("path", [PLACE, f"{PLACE}/run.json.gz"])
def test_the_report_of_a_row_s_run_is_written_elsewhere(root, path):
    before = sorted((root / "results").rglob("*"))
    succeed("report", path, directory=root)
    assert sorted((root / "results").rglob("*")) == before
    page = (root / "reports/hac/seed-0/table4/report.html").read_text()
    assert '"evaluate":"minitouch-bench evaluate' in page  # replay needs actions
    assert "exploration/pushing" not in page


@pytest.mark.parametrize("command", [("replay", PLACE, "pushing/1"), ("verify", PLACE)])
def test_a_run_without_actions_says_how_to_get_them(root, command):
    done = run(*command, directory=root)
    assert (done.code, done.out) == (6, "")
    assert "without its actions" in done.err
    assert "minitouch-bench evaluate" in done.err


def test_a_packed_run_is_the_run_and_a_damaged_one_is_named(root):
    packed = read_run(root / PLACE)
    write_file(root / "plain" / "run.json", packed.content)
    assert read_run(root / "plain").summary == packed.summary
    for content in (b"", b"\x1f\x8b" + bytes(20), b"text"):
        (root / PLACE / "run.json.gz").write_bytes(content)
        run("report", PLACE, directory=root).refused(6, "run.json")


def test_an_episode_is_looked_at_beside_its_run(copy):
    done = succeed("replay", copy, "opening/1", "--csv", "--video", directory=copy.parent)
    files = [copy / "replays" / f"opening-1.{suffix}" for suffix in ("html", "mp4", "csv")]
    assert done.out.split() == list(map(str, files))
    assert all(path.stat().st_size > 1000 for path in files)
    assert "succeeded after" in done.err
    assert "the same bits as recorded" in done.err
    succeed("verify", copy, directory=copy.parent)  # a view changes no report


@pytest.fixture(scope="module")
def idle(tmp_path_factory):
    """A run of Pushing's first episode by the policy that does nothing."""
    directory = tmp_path_factory.mktemp("idle")
    episode = ("--episodes-from", "pushing/1", "--seed", 0)
    succeed("evaluate", "zero", *episode, "--output", directory / "run", directory=directory)
    return directory / "run"


def test_an_episode_of_two_runs_is_shown_on_one_time_axis(scripted, idle, tmp_path, browser):
    page = tmp_path / "both.html"
    ends = ("--beside", idle, "--output", page)
    done = succeed("replay", scripted[1], "pushing/1", *ends, directory=tmp_path)
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


def test_two_runs_are_one_page_alone_and_of_one_scene(scripted, idle, tmp_path):
    command = ("replay", scripted[1], "pushing/1", "--beside")
    run(*command, idle, "--csv", directory=tmp_path).refused(2, "leave --video and --csv out")
    run(*command, idle, "--output", "x.avi", directory=tmp_path).refused(2, ".html", "x.avi")
    words = ("--episodes-from", "pushing/1", "--seed", 7, "--output", "other")
    succeed("evaluate", "zero", *words, directory=tmp_path)
    run(*command, "other", directory=tmp_path).refused(2, "not the same episode")
    assert not (scripted[1] / "replays").exists()
