import minari
import numpy as np
import pytest

from minitouch_bench.agents.logged_data import fill_from_log
from minitouch_bench.agents.replay import Replay
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.workflows.record import RecordOptions, record


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return record(RecordOptions("scripted", "pushing", tmp_path_factory.mktemp("data") / "log", 2))


def test_minari_reads_what_was_recorded(dataset):
    episodes = list(minari.MinariDataset(dataset).iterate_episodes())
    assert len(episodes) == 2
    for episode in episodes:
        steps = len(episode.actions)
        assert episode.observations["image"].shape == (steps + 1, 1, 84, 84)
        assert episode.observations["touch"].shape == (steps + 1, 11)
        ends = episode.terminations | episode.truncations
        assert np.flatnonzero(ends).tolist() == [steps - 1]
        assert np.flatnonzero(episode.infos["is_success"]).tolist() == [steps]
    first, second = (episode.observations["image"][0] for episode in episodes)
    assert not np.array_equal(first, second)


def test_a_training_reads_it_too(dataset):
    replay = Replay(1000, 11, 4, compress=True)
    fill_from_log(replay, dataset, 4)
    steps = [len(one.actions) for one in minari.MinariDataset(dataset).iterate_episodes()]
    assert replay.rows == sum(steps) + 2
    assert [end for _, end in replay.state()["successes"]] == [steps[0], replay.rows - 1]


def test_a_dataset_is_not_overwritten(dataset):
    with pytest.raises(RunDirectoryError, match="--output"):
        record(RecordOptions("random", "pushing", dataset, 1))


def test_an_unknown_task_is_named(tmp_path):
    with pytest.raises(UsageError, match="juggling"):
        record(RecordOptions("random", "juggling", tmp_path / "log", 1))
