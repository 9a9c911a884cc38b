"""A policy with other forces than its own, in the real simulator."""

import numpy as np
import pytest

from experiments.reliance import play
from minitouch_bench.episode import EpisodeSpec, Role
from minitouch_bench.simulation.observation import FORCES
from minitouch_bench.tasks.environment import MiniTouchEnv

SPECS = [EpisodeSpec(Role.FINAL, "opening", index, seed=index) for index in range(3)]


class AtRandom:
    """Acts at random in the scene's own way, and keeps the forces that it is given."""

    def reset(self, seed, task):
        self.given = []
        EPISODES.append(self.given)
        self._rng = np.random.default_rng(len(EPISODES) % 3)

    def act(self, observation):
        self.given.append(observation["touch"][FORCES].copy())
        return self._rng.uniform(-1.0, 1.0, 5).astype(np.float32)


EPISODES = []


@pytest.fixture
def world():
    environment = MiniTouchEnv("opening", max_steps=60)
    yield environment
    environment.close()


def test_late_forces_are_those_of_the_step_before(world):
    EPISODES.clear()
    played = play(AtRandom(), world, SPECS, "late")
    assert any(np.any(episode.trace.touch[:, FORCES]) for episode in played)
    for given, episode in zip(EPISODES, played, strict=True):
        felt = episode.trace.touch[:-1, FORCES]
        np.testing.assert_array_equal(given, [felt[0], *felt[:-1]])


def test_other_forces_are_those_of_another_episode_and_then_none(world):
    EPISODES.clear()
    played = play(AtRandom(), world, SPECS, "other")
    assert len(EPISODES) == 6  # each is played undisturbed first
    felt = [episode.trace.touch[:, FORCES] for episode in played]
    for given, other in zip(EPISODES[3:], [felt[-1], *felt[:-1]], strict=True):
        most = min(len(given), len(other))
        np.testing.assert_array_equal(given[:most], other[:most])
        assert not np.any(given[most:])
