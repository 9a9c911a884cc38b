"""The gate against data whose truth is known: false alarms and power.

Each trial draws two policies on the same episodes: the hardness of an episode is common to both,
half of each policy's outcomes its own luck.
"""

import math
from collections import Counter
from itertools import product

import numpy as np
import pytest

from minitouch_bench.comparison.gate import Decision, GateSettings, judge_endpoint
from minitouch_bench.comparison.pairing import MEAN_TASK, PairedValues

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]

GOALS = ("pushing", "opening", "pick-up")
GATES = 2000
STANDARD = GateSettings()
PER_TASK = (4, 10, 25)
"""Episodes of each task."""


def draw_gates(before, after, episodes, noise=0.5, seed=1):
    """Judge GATES gates of the mean success over three tasks; a policy is its skill by task."""
    rng = np.random.default_rng(seed)
    shape = (GATES, len(GOALS), episodes)
    hardness = rng.random(shape)
    sides = []
    for skill in (before, after):
        own = np.where(rng.random(shape) < noise, rng.random(shape), hardness)
        skills = np.broadcast_to(skill, len(GOALS))
        won = own < skills[:, None]
        sides.append(won.reshape(GATES, -1).astype(float))
    judged = {}  # by lost and won, on which the decision rests
    gates = []
    for first, second in zip(*sides, strict=True):
        key = ((first > second).sum(), (second > first).sum())
        if key not in judged:
            paired = PairedValues(MEAN_TASK, "success", GOALS, first, second)
            judged[key] = judge_endpoint(paired, STANDARD, (0,))
        gates.append(judged[key])
    found = Counter(gate.decision for gate in gates)
    beyond = sum(gate.is_beyond for gate in gates if gate.decision is Decision.NOT_ENOUGH)
    shares = {decision.value: count / GATES for decision, count in found.items()}
    print(f"\n{before} to {after}, luck {noise}, {episodes} per task: {shares}", end="")
    print(f", not enough and beyond the tolerance: {beyond / GATES}", flush=True)
    return {decision: found[decision] / GATES for decision in Decision}


@pytest.mark.parametrize("episodes", [*PER_TASK, 100])
@pytest.mark.parametrize(
    ("skill", "noise"),
    [*product((0.9, 0.6), (0.5, 1.0)), (0.95, 0.1), (0.5, 1.0), ((0.2, 0.5, 0.9), 0.5)],
)
def test_equal_policies_are_hardly_ever_a_regression(skill, noise, episodes):
    # The test is exact; with 300 pairs it uses nearly all of its level, and 2,000 gates vary.
    room = 0.0 if episodes in PER_TASK else 3 * math.sqrt(0.05 * 0.95 / GATES)
    assert draw_gates(skill, skill, episodes, noise)[Decision.REGRESSION] <= 0.05 + room


POWER = [
    (1.0, 0.0, {4: 0.99, 10: 0.99, 25: 0.99}),
    (0.9, 0.3, {4: 0.75, 10: 0.95, 25: 0.99}),
    (0.9, 0.6, {4: 0.15, 10: 0.6, 25: 0.95}),
    (0.9, (0.6, 0.9, 0.9), {4: 0.0, 10: 0.05, 25: 0.2}),
]
"""Skill before and after, and the least share of regressions by episodes per task."""


@pytest.mark.parametrize("noise", [0.5, 1.0])
@pytest.mark.parametrize("episodes", PER_TASK)
@pytest.mark.parametrize(("before", "after", "least"), POWER)
def test_a_worsening_is_seen(before, after, least, episodes, noise):
    assert draw_gates(before, after, episodes, noise)[Decision.REGRESSION] >= least[episodes]


def test_a_worsening_beyond_the_tolerance_hardly_ever_passes():
    # The truth is at the very tolerance, where a pass is most easily wrong.
    assert draw_gates(0.95, 0.90, 133, noise=0.1)[Decision.NO_REGRESSION] <= 0.05
