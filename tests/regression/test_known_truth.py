"""The statistics against data whose truth is known: false alarms, power, savings.

Each trial draws two runs of the same episodes: a task's hardness is common to both, half of
each policy's outcomes its own luck.
"""

import math
from collections import Counter

import numpy as np
import pytest

from minitouch_bench.regression.gate import Decision, judge_runs
from minitouch_bench.regression.sequential import SequentialGate, final_result, play_order
from minitouch_bench.regression.settings import GateSettings
from tests.regression.pairs import draw, make_saved, values

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]

TASKS = ("playing", "pushing", "opening", "pick-up")
GOALS = TASKS[1:]
TRIALS = 1000
N = 100
PATHS = ("a", "b")
SUCCESS = GateSettings(metrics=("success",))
SETTINGS = {"every metric": GateSettings(), "success": SUCCESS}


def draw_pair(rng, first, second, noise=0.5, n=N, tasks=TASKS):  # noqa: PLR0917 - a fixture
    """Two runs; a policy is its skill by task, or in all tasks."""
    hardness = {task: rng.random(n) for task in tasks}
    made = []
    for name, skill in (("a", first), ("b", second)):
        skills = skill if isinstance(skill, dict) else dict.fromkeys(tasks, skill)
        drawn = {task: draw(rng, skills[task], hardness[task], noise) for task in tasks}
        made.append(make_saved(drawn, name))
    return made


def sequential(first, second, settings):
    """The decision and the share of the episodes that it took."""
    gate = SequentialGate(play_order(first.episodes, (0,)), settings, (0,))
    gate.add(second.episodes)
    if gate.is_certain:
        return gate.decision, gate.used / gate.planned
    return final_result(first, second, PATHS, settings).decision, 1.0


def told(what, decisions):
    shares = {
        decision.value: count / len(decisions) for decision, count in Counter(decisions).items()
    }
    print(f"\n{what}: {shares}", flush=True)
    return Counter(decisions)


EQUAL = [
    (0.9, 0.5, "every metric", TRIALS),
    (0.95, 0.1, "every metric", 300),
    (0.9, 0.5, "success", TRIALS),
    (0.6, 0.5, "success", TRIALS),
]


@pytest.mark.parametrize(("skill", "noise", "settings", "trials"), EQUAL)
def test_equal_policies_are_hardly_ever_a_regression(skill, noise, settings, trials):
    rng = np.random.default_rng(1)
    decisions = [
        judge_runs(*draw_pair(rng, skill, skill, noise), PATHS, SETTINGS[settings]).decision
        for _ in range(trials)
    ]
    found = told(f"equal at {skill}, luck {noise}, {settings}, {trials} pairs", decisions)
    assert found[Decision.REGRESSION] / trials <= 0.05


SEQUENTIAL = [
    (0.9, 0.5, "success", TRIALS),
    (0.6, 0.5, "success", 300),
    (0.9, 0.5, "every metric", 200),
]


@pytest.mark.parametrize(("skill", "noise", "settings", "trials"), SEQUENTIAL)
def test_the_sequential_gate_keeps_the_level(skill, noise, settings, trials):
    rng = np.random.default_rng(2)
    found = told(
        f"sequential, equal at {skill}, luck {noise}, {settings}, {trials} pairs",
        [
            sequential(*draw_pair(rng, skill, skill, noise), SETTINGS[settings])[0]
            for _ in range(trials)
        ],
    )
    assert found[Decision.REGRESSION] / trials <= 0.05


def test_a_worsening_beyond_the_tolerance_hardly_ever_passes():
    # The truth is at the very tolerance, where a pass is most easily wrong.
    rng, trials, n = np.random.default_rng(3), 400, 400
    whole, looked = [], []
    for _ in range(trials):
        pair = draw_pair(rng, 0.95, 0.90, 0.1, n, ("pushing",))
        whole.append(judge_runs(*pair, PATHS, SUCCESS).decision)
        looked.append(sequential(*pair, SUCCESS)[0])
    for what, decisions in (("whole", whole), ("sequential", looked)):
        found = told(f"worse by the tolerance, {what}", decisions)
        assert found[Decision.PASSED] / trials <= 0.05


WORSE = {
    "one task of three": ({"pushing": 0.6, "opening": 0.9, "pick-up": 0.9}, 0.5),
    "all tasks": (0.6, 0.5),
}


@pytest.mark.parametrize("settings", SETTINGS)
@pytest.mark.parametrize("worse", WORSE)
def test_a_clear_regression_is_caught_with_half_of_the_episodes(worse, settings):
    rng, trials = np.random.default_rng(4), 200
    skill, noise = WORSE[worse]
    found = [
        sequential(*draw_pair(rng, 0.9, skill, noise, N, GOALS), SETTINGS[settings])
        for _ in range(trials)
    ]
    decisions = told(f"0.9 to 0.6 in {worse}, {settings}", [decision for decision, _ in found])
    used = float(np.mean([share for _, share in found]))
    print(f"episodes used: {used:.2f} of all, {used * N * len(GOALS):.0f} of {N * len(GOALS)}")
    assert decisions[Decision.REGRESSION] / trials >= 0.95
    assert used <= 0.5


def test_as_many_episodes_as_printed_settle_the_matter():
    # 12 lost and 4 won of 100: beyond the tolerance, and not significant over three tasks.
    rng, trials = np.random.default_rng(5), 500

    def pair(lost, won, n):
        places = np.arange(n)
        before, after = places < n - won, (places >= lost)
        return [
            make_saved({"pushing": values(side), **rest(n)}, name)
            for name, side in (("a", before), ("b", after))
        ]

    def rest(n):
        return {task: values(np.ones(n, bool)) for task in GOALS[1:]}

    judged = judge_runs(*pair(12, 4, N), PATHS, SUCCESS).judged[0]
    assert judged.decision is Decision.INCONCLUSIVE
    counts = rng.multinomial(judged.episodes_needed, (0.12, 0.04, 0.84), trials)
    seen = np.mean(
        [
            judge_runs(*pair(int(lost), int(won), judged.episodes_needed), PATHS, SUCCESS)
            .judged[0]
            .decision
            is Decision.REGRESSION
            for lost, won, _ in counts
        ]
    )
    print(f"\n{judged.episodes_needed} episodes printed: caught in {seen:.3f}")
    assert abs(seen - 0.8) <= 3 * math.sqrt(0.16 / trials) + 0.02
