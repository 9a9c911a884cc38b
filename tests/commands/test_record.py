import errno
import signal

import minari
import numpy as np
import pytest
import typer

from minitouch_bench.agents.memory import ReplayMemory
from minitouch_bench.agents.training import fill_from_dataset
from minitouch_bench.commands.record import record
from minitouch_bench.errors import PolicyLoadError, RunDirectoryError, UsageError
from minitouch_bench.protocol.minitouch import PICK_UP, PUSHING
from tests.commands.command import finish, start
from tests.process_tree import WITHOUT_LOCKS, run_python, wait_until


def test_minari_and_a_training_read_what_was_recorded_and_it_is_not_overwritten(tmp_path):
    dataset = tmp_path / "log"
    record("scripted", "pushing", output=dataset, episodes=2)
    episodes = list(minari.MinariDataset(dataset).iterate_episodes())
    assert len(episodes) == 2
    for episode in episodes:
        steps = len(episode.actions)
        assert episode.observations["image"].shape == (steps + 1, 1, 84, 84)
        assert episode.observations["touch"].shape == (steps + 1, 11)
        ends = episode.terminations | episode.truncations
        assert np.flatnonzero(ends).tolist() == [steps - 1]
        assert np.flatnonzero(episode.infos["is_success"]).tolist() == [steps]
    replay = ReplayMemory(1000, 11, 4)
    fill_from_dataset(replay, dataset, PUSHING)
    assert replay.rows == sum(len(one.actions) + 1 for one in episodes)
    with pytest.raises(UsageError, match="recorded in pushing"):
        fill_from_dataset(replay, dataset, PICK_UP)
    with pytest.raises(RunDirectoryError, match="--output"):
        record("random", "pushing", output=dataset, episodes=1)


def test_a_fault_is_no_end_of_the_task(tmp_path):
    """A memory that learned from it would take the last state for a goal."""
    options = {"task": "pushing", "episodes": 1, "trust": True}
    with pytest.raises(typer.Exit) as end:
        record("misbehaved:FaultInPushing", output=tmp_path / "log", **options)
    assert end.value.exit_code == 4
    dataset = minari.MinariDataset(tmp_path / "log")
    (episode,) = dataset.iterate_episodes()
    assert episode.terminations.tolist() == [False, False]
    assert episode.truncations.tolist() == [False, True]
    assert dataset.spec.dataset_id == "minitouch/pushing/misbehaved-FaultInPushing-v0"
    with pytest.raises(PolicyLoadError, match="nothing learned"):
        record("misbehaved:Hopeless", output=tmp_path / "none", **options)


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_a_recording_that_is_stopped_leaves_nothing(tmp_path, stop):
    command = ("record", "random", "opening", "--episodes", 1000, "--output", "log")
    process = start(*command, directory=tmp_path)
    wait_until(lambda: list(tmp_path.glob(".log.unfinished/log/*")), 250)
    process.send_signal(stop)
    done = finish(process)
    assert (done.code, done.out) == (130, "")
    assert done.err.endswith("minitouch-bench: interrupted\n")
    assert list(tmp_path.iterdir()) == []


WITHOUT = f"""
import sys
from pathlib import Path
from minitouch_bench.agents.training import fill_from_dataset
from minitouch_bench.agents.memory import ReplayMemory
from minitouch_bench.commands.record import record
from minitouch_bench.protocol.minitouch import PUSHING
{WITHOUT_LOCKS}
record("random", "pushing", output=Path(sys.argv[1]), episodes=1)
replay = ReplayMemory(1000, 11, 4)
fill_from_dataset(replay, Path(sys.argv[1]), PUSHING)
assert replay.rows
"""


def test_a_file_system_without_locks_and_what_a_kill_left_are_no_obstacle(tmp_path):
    (tmp_path / ".log.unfinished" / "log" / "data").mkdir(parents=True)
    run_python("-c", WITHOUT, errno.ENOLCK, tmp_path / "log")
    assert list(tmp_path.iterdir()) == [tmp_path / "log"]
    assert len(list(minari.MinariDataset(tmp_path / "log").iterate_episodes())) == 1
