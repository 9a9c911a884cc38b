"""Rows played from real checkpoints: what is kept, what is played again, and what is not."""

from dataclasses import replace

import pytest

from minitouch_bench.errors import InfrastructureError, InterruptedRunError, RunDirectoryError
from minitouch_bench.evaluation import execution
from minitouch_bench.evaluation.engine import SILENT, Callbacks, stopping_after
from minitouch_bench.evaluation.execution import HOPELESS_AFTER
from minitouch_bench.files import lock_directory
from minitouch_bench.json_io import write_toml
from minitouch_bench.leaderboard import play as entries
from minitouch_bench.leaderboard.fresh import drop_p
from minitouch_bench.leaderboard.play import ROW_FILE, play_row
from minitouch_bench.policies.native import save_native
from minitouch_bench.policies.networks import TouchActor, VisualEncoder
from tests.evaluation.runs import Here
from tests.leaderboard.playing import (
    EPISODES,
    RUNS,
    TASKS,
    digests,
    play_few,
    play_quickly,
    write_policy,
)
from tests.leaderboard.synthetic import ABOUT, entry_of, make_submission
from tests.process_tree import run_python

ALL = 2 * EPISODES * (2 * len(TASKS))
"""Episodes of a row: official and fresh ones, of the final and the exploration policy."""


@pytest.fixture(autouse=True)
def few_episodes(monkeypatch):
    play_quickly(monkeypatch)


@pytest.fixture(scope="module")
def checkpoints(tmp_path_factory):
    """The bytes of two policies."""
    folder = tmp_path_factory.mktemp("policies")
    return [write_policy(folder / f"{n}.safetensors", n).read_bytes() for n in range(2)]


def submit(root, final, explored, about=ABOUT):
    """Write a submission whose checkpoints have these bytes."""
    options = {"content": final, "explored": explored, "about": about}
    return entry_of(make_submission(root / "submissions", **options))


@pytest.fixture
def entry(tmp_path, checkpoints):
    return submit(tmp_path, *checkpoints)


class Count:
    """Callbacks that count episodes, and act at one of them."""

    def __init__(self, at=0, act=None):
        self.episodes, self.notes = 0, []
        self.at, self.act = at, act

    def episode(self, _):
        self.episodes += 1
        if self.episodes == self.at:
            self.act()

    def callbacks(self):
        return Callbacks(note=self.notes.append, episode=self.episode)


def interrupt():
    raise KeyboardInterrupt


def play(entry, callbacks=SILENT, **options):
    return play_row(entry, Here(), callbacks, directory=entry.results.parent / "play", **options)


def test_a_row_is_played_once_and_read_back(entry):
    count = Count()
    row = play(entry, count.callbacks())
    assert (row.played, row.waiting, count.episodes) == (("table4",), "", ALL)
    assert digests(entry.results).keys() == {*RUNS}
    played = entry.read()
    assert row.drop_p == drop_p(played.official, played.fresh)
    (official,), (fresh,) = (runs["table4"] for runs in (played.official, played.fresh))
    assert official.tasks == fresh.tasks == TASKS
    seeds = [{one.seed for one in run.rows} for run in (official, fresh)]
    assert not seeds[0] & seeds[1]
    assert not (entry.results.parent / "play" / entry.name).exists()
    kept = {path.name for path in entry.results.rglob("*") if path.is_file()}
    assert kept == {"row.toml", "run.json.gz"}
    again = Count()
    assert play(entry, again.callbacks()) == row
    assert again.episodes == 0


def test_the_draw_is_written_before_the_first_episode_and_kept(entry):
    def look():
        assert entry.read_row().draws
        interrupt()

    with pytest.raises(InterruptedRunError):
        play(entry, Count(1, look).callbacks())
    drawn = entry.read_row()
    assert drawn.played == ()
    assert len(drawn.draws[0].randomness) == 64
    assert play(entry).draws == drawn.draws


def test_another_checkpoint_is_played_with_another_draw(entry, tmp_path, checkpoints):
    before = play(entry)
    kept = digests(entry.results)
    other = submit(tmp_path, *reversed(checkpoints))
    count = Count()
    after = play(other, count.callbacks())
    assert count.episodes == ALL
    assert after.draws[0].randomness != before.draws[0].randomness
    assert not {*digests(entry.results).values()} & {*kept.values()}
    (entry.results / ROW_FILE).write_text(write_toml(replace(after, draws=before.draws)))
    with pytest.raises(RunDirectoryError, match="other checkpoints"):
        entry.read()


def test_a_damaged_result_is_named_and_played_again(entry):
    play(entry)
    kept = digests(entry.results)
    file = entry.results / RUNS[1] / "run.json.gz"
    file.write_bytes(b"\x1f\x8b" + bytes(30))
    with pytest.raises(RunDirectoryError, match=r"table4-fresh\b.*\brun\.json"):
        entry.read()
    count = Count()
    play(entry, count.callbacks())
    assert count.episodes == ALL / 2
    assert any("played again" in line for line in count.notes)
    assert digests(entry.results) == kept


def test_the_time_of_stop_after_ends_it_and_the_same_call_continues(entry):
    count, shown = Count(), []
    for _ in range(2):  # a run's last episode stops nothing
        with pytest.raises(InfrastructureError, match=r"stopped before the last episode"):
            play(entry, stopping_after(1e-9, count.callbacks()))
        shown.append(count.episodes)
    assert shown == [1, 4]  # of the first run one, then that and another, and one of the second
    row = play(entry, stopping_after(1e-9, count.callbacks()))
    assert row.played == ("table4",)
    with lock_directory(entry.results), pytest.raises(RunDirectoryError, match="in use"):
        play(entry)


def test_an_unfinished_run_that_cannot_be_continued_begins_again_and_that_is_said(
    entry, monkeypatch
):
    with pytest.raises(InterruptedRunError):
        play(entry, Count(2, interrupt).callbacks())
    versions = execution.package_versions()
    monkeypatch.setattr(execution, "package_versions", lambda: {**versions, "numpy": "0"})
    count = Count()
    play(entry, count.callbacks())
    assert count.episodes == ALL
    assert any("other packages" in note and "beginning" in note for note in count.notes)


TWO = ("table4", "novel-shapes")


@pytest.fixture
def entry_of_two(tmp_path, checkpoints):
    return submit(tmp_path, *checkpoints, about=replace(ABOUT, suites=TWO))


def test_a_row_that_is_stopped_shows_the_suites_that_are_finished(entry_of_two):
    with pytest.raises(InterruptedRunError):
        play(entry_of_two, Count(ALL + 1, interrupt).callbacks())
    row = entry_of_two.read_row()
    assert row.played == TWO[:1]
    assert row.drop_p == play(entry_of_two, suites=TWO[:1]).drop_p
    assert [*entry_of_two.read().official] == [*TWO[:1]]
    assert play(entry_of_two).played == TWO
    (entry_of_two.results / ROW_FILE).write_text(write_toml(replace(row, played=())))
    assert entry_of_two.read().official == {}


def test_a_suite_is_played_alone_whatever_lies_of_the_others(entry_of_two, tmp_path):
    with pytest.raises(InterruptedRunError):
        play(entry_of_two, Count(2, interrupt).callbacks(), suites=TWO[:1])
    assert play(entry_of_two, suites=TWO[1:]).played == TWO[1:]
    unfinished = (tmp_path / "results/play/hac").glob("*/seed-0/*")
    assert [path.name for path in unfinished] == ["table4"]
    assert play(entry_of_two, suites=TWO[:1]).played == TWO
    (entry_of_two.results / "seed-0/novel-shapes/run.json.gz").write_bytes(b"\x1f\x8b")
    notes = Count()
    assert play(entry_of_two, notes.callbacks(), suites=TWO[:1]).played == TWO[:1]
    assert notes.notes == []


def test_a_training_that_takes_too_long_stays_waiting(entry, monkeypatch):
    monkeypatch.setattr(entries, "PLAY_LIMIT_S", 1e-6)
    monkeypatch.setattr(entries, "MEASURED_S", 0.0)
    count = Count()
    row = play(entry, count.callbacks())
    assert (count.episodes, row.played) == (1, ())
    assert "hours" in entry.read_row().waiting
    count = Count()
    play(entry, count.callbacks())
    assert count.episodes == 2  # that of before, whose time is not known, and a new one


def test_a_policy_that_fails_from_the_first_is_never_played_on(tmp_path, monkeypatch):
    play_few(monkeypatch, official=2 * HOPELESS_AFTER)
    broken = TouchActor(5, encoder=VisualEncoder(1 / 32))
    for weights in broken.parameters():
        weights.data.fill_(float("nan"))
    save_native(broken, tmp_path / "broken.safetensors")
    content = (tmp_path / "broken.safetensors").read_bytes()
    entry = submit(tmp_path / "broken", content, b"")
    for _ in range(2):
        count = Count()
        row = play(entry, count.callbacks())
        assert (count.episodes, row.played) == (HOPELESS_AFTER, ())
        assert "policy faults" in row.waiting


def test_a_policy_that_cannot_be_loaded_stays_waiting_with_the_reason(tmp_path, checkpoints):
    broken = submit(tmp_path, b"no policy", checkpoints[1])
    row = play(broken)
    assert row.played == ()
    assert "hac.safetensors" in broken.read_row().waiting


PLAY = """
import os, signal, sys
from pathlib import Path
import pytest
from tests.leaderboard.playing import play_quickly
from tests.leaderboard.synthetic import entry_of
from tests.leaderboard.test_play import Count, play
play_quickly(pytest.MonkeyPatch())
count = Count(int(sys.argv[2]), lambda: os.kill(os.getpid(), signal.SIGKILL))
play(entry_of(Path(sys.argv[1])), count.callbacks())
"""


def test_a_killed_and_interrupted_row_gives_the_bits_of_an_undisturbed_one(
    entry, tmp_path, checkpoints
):
    whole = submit(tmp_path / "whole", *checkpoints)
    whole.results.mkdir(parents=True)
    for killed_at, interrupted_at in ((1, 2), (3, 2)):
        run_python("-c", PLAY, entry.directory, killed_at, code=-9)
        with pytest.raises(InterruptedRunError):
            play(entry, Count(interrupted_at, interrupt).callbacks())
        assert entry.read_row().played == ()
    (whole.results / ROW_FILE).write_bytes((entry.results / ROW_FILE).read_bytes())
    assert play(whole) == play(entry)
    assert digests(entry.results) == digests(whole.results)
