import numpy as np
import pytest

from minitouch_bench.errors import PolicyFaultError
from minitouch_bench.evaluation.rollout import GivenActions

ACTIONS = np.random.default_rng(0).uniform(-1, 1, (6, 4)).astype(np.float32)


def give(path, actions):
    with GivenActions(4, path) as given:
        given.begin_attempt()
        for action in actions:
            given.add(action)


def test_the_longest_attempt_counts_and_not_the_last(tmp_path):
    path = tmp_path / "given"
    give(path, ACTIONS[:5])
    give(path, ACTIONS[:2])
    give(path, [])
    other = ACTIONS.copy()
    other[4, 0] += 1e-6
    with pytest.raises(PolicyFaultError, match="did not repeat"):
        give(path, other)
    give(path, ACTIONS)
    assert path.read_bytes() == ACTIONS.tobytes()


def test_it_holds_within_a_process_too():
    given = GivenActions(4)
    given.add(ACTIONS[0])
    given.begin_attempt()
    given.add(ACTIONS[0])
    given.begin_attempt()
    with pytest.raises(PolicyFaultError, match="did not repeat"):
        given.add(ACTIONS[1])


def test_an_action_that_was_cut_short_is_none(tmp_path):
    path = tmp_path / "given"
    path.write_bytes(ACTIONS[:2].tobytes()[:-3])
    give(path, ACTIONS[[0, 5]])
    assert path.read_bytes() == ACTIONS[[0, 5]].tobytes()


def test_it_is_no_link_and_no_pipe(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "mine")
    with pytest.raises(OSError, match="symbolic"):
        GivenActions(4, tmp_path / "link")
    assert not (tmp_path / "mine").exists()
