"""A policy made worse on purpose is caught in the real simulator; one that is not passes."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from minitouch_bench.comparison.gate import Decision, GateResult, GateSettings, judge_runs
from minitouch_bench.evaluation.execution import header_of
from minitouch_bench.evaluation.rollout import LocalEngine
from minitouch_bench.policies.scripted import ScriptedPolicy
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.runs.plan import Plan, make_plan
from minitouch_bench.runs.run import Run, RunEnvironment, make_run
from tests.evaluation.runs import request

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]

EPISODES = 20
ENOUGH = 80
"""Episodes a task that exclude a loss of 5 points where no outcome changes: 73."""


STRENGTHS = (0.2, 0.5, 1.0)
"""Standard deviations of the noise, where the largest action is 1."""

NOWHERE = RunEnvironment({}, {}, 1, "", 0.0)


class NoisyPolicy(ScriptedPolicy):
    """Adds normal noise to every number of every action."""

    def __init__(self, world_of, deviation: float) -> None:
        super().__init__(world_of)
        self._deviation = deviation

    def reset(self, seed, task):
        super().reset(seed, task)
        self._rng = np.random.default_rng([seed, 1])

    def act(self, observation):
        action = super().act(observation)
        noise = self._rng.normal(0.0, self._deviation, action.shape)
        return np.clip(action + noise, -1.0, 1.0).astype(np.float32)


class HalfPolicy(ScriptedPolicy):
    """Gives its actions in half precision, as a compressed policy would."""

    def act(self, observation):
        return super().act(observation).astype(np.float16).astype(np.float32)


@dataclass(frozen=True)
class Variant:
    """Where a worker gets its policies from. ``noise`` None: half precision."""

    noise: float | None = None
    plan: Plan = field(default_factory=lambda: make_plan("table4"))

    def make_policy(self, role, world_of):
        return HalfPolicy(world_of) if self.noise is None else NoisyPolicy(world_of, self.noise)


def play(variant: Variant, name: str, episodes: int, tasks: Sequence[str] = GOAL_TASKS) -> Run:
    wanted = request(tasks=tuple(tasks), episodes=episodes)
    header = header_of(wanted)
    header = replace(header, policy=replace(header.policy, name=name))
    specs = header.specs()
    records = {record.spec: record for record in LocalEngine(2).run(variant, specs)}
    return make_run(header, NOWHERE, [records[spec] for spec in specs], name)


def judged(baseline: Run, candidate: Run) -> GateResult:
    return judge_runs(baseline, candidate, ("base", "candidate"), GateSettings())


@pytest.fixture(scope="module")
def baseline():
    return play(Variant(0.0), "scripted", EPISODES)


@pytest.mark.parametrize("noise", STRENGTHS)
def test_noise_on_the_actions_is_caught(baseline, noise):
    candidate = play(Variant(noise), f"noise {noise}", EPISODES)
    result = judged(baseline, candidate)
    assert (result.decision, result.exit_code) == (Decision.REGRESSION, 1)


def test_half_precision_is_no_regression():
    base, half = play(Variant(0.0), "scripted", ENOUGH), play(Variant(), "half", ENOUGH)
    assert base.digest != half.digest
    result = judged(base, half)
    assert result.exit_code == 0
    assert not result.identical


def test_no_noise_has_the_same_bits(baseline):
    result = judged(baseline, play(Variant(0.0), "again", EPISODES))
    assert result.identical
    assert result.exit_code == 0
