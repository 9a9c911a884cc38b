import os

import numpy as np
import pytest
import torch

from minitouch_bench.agents.memory import CheckpointFiles, ReplayMemory
from minitouch_bench.errors import RunDirectoryError


def image(number):
    return np.full((1, 84, 84), number % 256, np.uint8)


def touch(number):
    return np.full(11, number, np.float32)


def fill(memory, episodes):
    """Add episodes of a length each; row i shows i, its action is i, its reward i at the end."""
    for length, reward, ended in episodes:
        memory.begin_episode(image(memory.rows), touch(memory.rows))
        for step in range(1, length + 1):
            last = step == length
            row = memory.rows
            memory.add(
                np.full(4, row - 1, np.float32), reward if last else 0.0,
                image(row), touch(row), success=reward > 0 and last, ended=ended and last,
            )  # fmt: skip


def sample(memory, size=256, n_step=1, share=0.0, seed=0):
    return memory.sample(
        np.random.default_rng(seed), size,
        n_step=n_step, discount=0.5, success_share=share, device=torch.device("cpu"),
    )  # fmt: skip


@pytest.fixture
def memory():
    return ReplayMemory(1000, 11, 4)


def test_transitions_stay_within_their_episode(memory):
    fill(memory, [(3, 0.0, False), (2, 25.0, True)])
    batch = sample(memory)
    starts = batch.action[:, 0].int()
    assert set(starts.tolist()) == {0, 1, 2, 4, 5}
    assert torch.equal(batch.touch[:, 0].int(), starts)
    assert torch.equal(batch.next_touch[:, 0].int(), starts + 1)
    assert torch.equal(batch.next_image[:, 0, 0, 0].int(), starts + 1)
    assert torch.equal(batch.ended, starts == 5)
    assert torch.equal(batch.task_reward, 25.0 * (starts == 5))


def test_n_step_returns_stop_at_the_end_of_an_episode(memory):
    fill(memory, [(4, 8.0, True)])
    batch = sample(memory, n_step=3)
    expected = {0: (0.0, 0.125, 3), 1: (2.0, 0.125, 4), 2: (4.0, 0.25, 4), 3: (8.0, 0.5, 4)}
    for row, start in enumerate(batch.action[:, 0].int().tolist()):
        reward, discount, reached = expected[start]
        assert batch.task_reward[row] == reward
        assert batch.discount[row] == discount
        assert batch.next_touch[row, 0] == reached
        assert batch.ended[row] == (start > 0)


def test_what_led_to_a_success_is_a_share_of_the_batch(memory):
    fill(memory, [(40, 0.0, False), (5, 25.0, True), (40, 0.0, False)])
    batch = sample(memory, size=1000, share=0.25)
    starts = batch.action[:, 0]
    led_to_success = (starts >= 41) & (starts <= 45)
    assert memory.state()["_led_to_success"].nonzero().flatten().tolist() == [*range(41, 46)]
    assert 0.2 < led_to_success.float().mean() < 0.3
    starts = sample(memory, size=1000).action[:, 0]
    assert not ((starts >= 41) & (starts <= 45)).float().mean() > 0.15


def test_a_share_that_successes_have_anyway_is_not_drawn_again(memory):
    fill(memory, [(40, 0.0, False), (40, 25.0, True)])
    batch = sample(memory, size=1000, share=0.25)
    assert memory.state()["_led_to_success"].nonzero().flatten().tolist() == [*range(41, 81)]
    assert 0.4 < (batch.action[:, 0] >= 41).float().mean() < 0.6


def test_the_oldest_rows_leave():
    memory = ReplayMemory(20, 11, 4)
    fill(memory, [(9, 25.0, True)] * 5)
    assert len(memory) == 20
    batch = sample(memory, share=0.5)
    assert batch.action[:, 0].min() >= 30
    state = memory.state()
    assert torch.equal(state["_led_to_success"], ~state["_last"])
    assert torch.equal(batch.next_image[:, 0, 0, 0].float(), batch.action[:, 0] + 1)


@pytest.mark.parametrize("capacity", [20, 1000])
def test_a_copy_from_state_and_pictures_samples_the_same(capacity):
    memory, other = (ReplayMemory(capacity, 11, 4) for _ in range(2))
    fill(memory, [(9, 25.0, True)] * 5)
    images = memory.images_since(memory.rows - len(memory))
    other.load(memory.state(), images)
    fill(memory, [(3, 0.0, False)])
    fill(other, [(3, 0.0, False)])
    first, second = (sample(one, share=0.3, n_step=2) for one in (memory, other))
    for name, value in vars(first).items():
        assert torch.equal(value, getattr(second, name)), name
    assert np.array_equal(memory.episode_actions(), other.episode_actions())


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_a_checkpoint_that_is_not_a_file_is_refused_without_waiting(tmp_path, make):
    CheckpointFiles(tmp_path).save({}, ReplayMemory(8, 11, 4))
    (tmp_path / "checkpoint.pt").unlink()
    make(tmp_path / "checkpoint.pt")
    with pytest.raises(RunDirectoryError, match="checkpoint"):
        CheckpointFiles(tmp_path).load(ReplayMemory(8, 11, 4))
