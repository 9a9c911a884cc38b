"""A policy with other forces than its own, in the real simulator."""

from dataclasses import replace

import numpy as np
import pytest

import minitouch_bench as mt
from experiments import reliance
from experiments.reliance import WORDS, OtherForces, reliance_rows
from minitouch_bench.simulation.observation import FORCES
from tests.evaluation.runs import Here, play_here
from tests.leaderboard.playing import write_policy


class AtRandom:
    """Acts at random, and keeps the forces that it is given."""

    def reset(self, seed, task):
        self.given, self._rng = [], np.random.default_rng(seed)

    def act(self, observation):
        self.given.append(observation["touch"][FORCES].copy())
        return self._rng.uniform(-1.0, 1.0, 5).astype(np.float32)


@pytest.mark.parametrize(
    ("forces", "expected"), [(None, [0, 0, 1, 2]), ({7: [5, 6]}, [5, 6, 0, 0])]
)
def test_late_forces_are_those_of_the_step_before_and_listed_ones_end_in_none(forces, expected):
    policy = AtRandom()
    listed = forces and {7: np.array([np.full(6, force) for force in forces[7]], np.float32)}
    changed = OtherForces(policy, listed)
    changed.reset(7, "opening")
    for force in range(4):
        observation = {"image": None, "touch": np.full(11, force, np.float32)}
        changed.act(observation)
        assert (observation["touch"] == force).all()
    assert [given.tolist() for given in policy.given] == [[force] * 6 for force in expected]


def test_a_finished_policy_plays_its_episodes_again_with_other_forces(tmp_path, monkeypatch):
    play_here(monkeypatch, steps=20)
    monkeypatch.setattr(reliance, "LocalEngine", lambda _: Here())
    file = write_policy(tmp_path / "final.safetensors")
    run = mt.evaluate(str(file), tasks=["opening"], episodes=2)
    rows = reliance_rows(file, run, {"episodes": 2, "forces": [*WORDS]})
    assert rows["estimates"]["conditions"].tolist() == [*WORDS.values()]
    assert rows["episodes"]["index"].tolist() == [0, 1, 0, 1]
    with pytest.raises(mt.MiniTouchError, match="again"):
        reliance_rows(file, replace(run, rows=run.rows[::-1]), {"episodes": 2, "forces": []})
