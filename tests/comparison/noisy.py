"""The scripted policy made worse on purpose, played by the real simulator.

As a program it prints how the gate judges each: ``python -m tests.comparison.noisy [EPISODES]``.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from minitouch_bench.comparison.gate import GateResult, GateSettings, judge_runs
from minitouch_bench.comparison.gate_report import difference_text, result_line
from minitouch_bench.evaluation.execution import header_of
from minitouch_bench.evaluation.rollout import LocalEngine
from minitouch_bench.perturbation import UNPERTURBED, Perturbation
from minitouch_bench.policies.scripted import ScriptedPolicy
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.runs.run import Run, RunEnvironment, make_run
from tests.evaluation.runs import request

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
    perturbation: Perturbation = UNPERTURBED

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


def report(baseline: Run, candidate: Run) -> None:
    result = judged(baseline, candidate)
    print(f"\n{candidate.name}: {result_line(result)}", flush=True)
    for one in result.per_task:
        effect = one.effect
        print(
            f"  {effect.task} {effect.metric}: {effect.first:.2f} -> {effect.second:.2f}, "
            f"{difference_text(effect)}{', worse' * one.is_worse}"
        )


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    base = play(Variant(0.0), "scripted", count)
    for deviation in (0.001, *STRENGTHS):
        report(base, play(Variant(deviation), f"noise {deviation}", count))
    report(base, play(Variant(), "half precision", count))
