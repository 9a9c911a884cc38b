import os

import numpy as np
import pytest
import torch

from minitouch_bench.agents.replay import CheckpointFiles, Replay
from minitouch_bench.errors import RunDirectoryError

CPU = torch.device("cpu")


def image(number):
    return np.full((1, 84, 84), number % 256, np.uint8)


def touch(number):
    return np.full(11, number, np.float32)


def fill(replay, episodes):
    """Add episodes of a length each; row i shows i, its action is i, its reward i at the end."""
    for length, reward, ended in episodes:
        replay.begin_episode(image(replay.rows), touch(replay.rows))
        for step in range(1, length + 1):
            last = step == length
            row = replay.rows
            replay.add(
                np.full(4, row - 1, np.float32), reward if last else 0.0,
                image(row), touch(row), success=reward > 0 and last, ended=ended and last,
            )  # fmt: skip


def sample(replay, size=256, n_step=1, share=0.0, seed=0):
    return replay.sample(
        np.random.default_rng(seed), size,
        n_step=n_step, discount=0.5, success_share=share, device=CPU,
    )  # fmt: skip


@pytest.fixture
def replay():
    return Replay(1000, 11, 4)


def test_transitions_stay_within_their_episode(replay):
    fill(replay, [(3, 0.0, False), (2, 25.0, True)])
    batch = sample(replay)
    starts = batch.action[:, 0].int()
    assert set(starts.tolist()) == {0, 1, 2, 4, 5}
    assert torch.equal(batch.touch[:, 0].int(), starts)
    assert torch.equal(batch.next_touch[:, 0].int(), starts + 1)
    assert torch.equal(batch.next_image[:, 0, 0, 0].int(), starts + 1)
    assert torch.equal(batch.ended, starts == 5)
    assert torch.equal(batch.task_reward, 25.0 * (starts == 5))


def test_n_step_returns_stop_at_the_end_of_an_episode(replay):
    fill(replay, [(4, 8.0, True)])
    batch = sample(replay, n_step=3)
    expected = {0: (0.0, 0.125, 3), 1: (2.0, 0.125, 4), 2: (4.0, 0.25, 4), 3: (8.0, 0.5, 4)}
    for row, start in enumerate(batch.action[:, 0].int().tolist()):
        reward, discount, reached = expected[start]
        assert batch.task_reward[row] == reward
        assert batch.discount[row] == discount
        assert batch.next_touch[row, 0] == reached
        assert batch.ended[row] == (start > 0)


def test_what_led_to_a_success_is_a_share_of_the_batch(replay):
    fill(replay, [(40, 0.0, False), (5, 25.0, True), (40, 0.0, False)])
    batch = sample(replay, size=1000, share=0.25)
    starts = batch.action[:, 0]
    led_to_success = (starts >= 41) & (starts <= 45)
    assert replay.state()["_led_to_success"].nonzero().flatten().tolist() == [*range(41, 46)]
    assert 0.2 < led_to_success.float().mean() < 0.3
    starts = sample(replay, size=1000).action[:, 0]
    assert not ((starts >= 41) & (starts <= 45)).float().mean() > 0.15


def test_a_share_that_successes_have_anyway_is_not_drawn_again(replay):
    fill(replay, [(40, 0.0, False), (40, 25.0, True)])
    batch = sample(replay, size=1000, share=0.25)
    assert replay.state()["_led_to_success"].nonzero().flatten().tolist() == [*range(41, 81)]
    assert 0.4 < (batch.action[:, 0] >= 41).float().mean() < 0.6


def test_the_oldest_rows_leave():
    replay = Replay(20, 11, 4)
    fill(replay, [(9, 25.0, True)] * 5)
    assert len(replay) == 20
    batch = sample(replay, share=0.5)
    assert batch.action[:, 0].min() >= 30
    state = replay.state()
    assert torch.equal(state["_led_to_success"], ~state["_last"])
    assert torch.equal(batch.next_image[:, 0, 0, 0].float(), batch.action[:, 0] + 1)


@pytest.mark.parametrize("capacity", [20, 1000])
def test_a_copy_from_state_and_pictures_samples_the_same(capacity):
    replay, other = (Replay(capacity, 11, 4) for _ in range(2))
    fill(replay, [(9, 25.0, True)] * 5)
    images = replay.images_since(replay.rows - len(replay))
    other.load(replay.state(), lambda held: images[len(images) - held :])
    fill(replay, [(3, 0.0, False)])
    fill(other, [(3, 0.0, False)])
    first, second = (sample(one, share=0.3, n_step=2) for one in (replay, other))
    for name, value in vars(first).items():
        assert torch.equal(value, getattr(second, name)), name
    assert np.array_equal(replay.episode_actions(), other.episode_actions())


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_a_checkpoint_that_is_not_a_file_is_refused_without_waiting(tmp_path, make):
    CheckpointFiles(tmp_path).save({}, Replay(8, 11, 4))
    (tmp_path / "checkpoint.pt").unlink()
    make(tmp_path / "checkpoint.pt")
    with pytest.raises(RunDirectoryError, match="checkpoint"):
        CheckpointFiles(tmp_path).load(Replay(8, 11, 4))
