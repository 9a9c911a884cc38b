"""What a finished policy does with other forces than those that its fingers feel."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import minitouch_bench as mt
from minitouch_bench.episode import EpisodeSpec, Observation, PlayedEpisode, Role
from minitouch_bench.evaluation.engine import LocalEngine
from minitouch_bench.evaluation.rollout import WorldOf
from minitouch_bench.metrics.intervals import wilson
from minitouch_bench.metrics.summary import episodes_frame, measure
from minitouch_bench.policies.policy import Policy, PolicySource, load_policy
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.runs.plan import Plan
from minitouch_bench.simulation.observation import FORCES

WORDS = {"late": "forces of one step before", "other": "forces of another episode"}
"""What the rows of each way say in their column ``conditions``."""

ForcesBySeed = Mapping[int, NDArray[np.float32]]
"""Forces (T, 6) of an episode's control steps, by the seed that the policy is given."""


class OtherForces:
    """A policy that is given the forces of a list, one row per control step, and then 0 N.

    Without a list: those of one control step before, in the first step those of the reset.
    """

    def __init__(self, policy: Policy, forces: ForcesBySeed | None) -> None:
        self._policy, self._forces = policy, forces

    def reset(self, seed: int, task: str) -> None:
        """Begin an episode."""
        self._step, self._before = 0, None
        self._given = None if self._forces is None else self._forces[seed]
        self._policy.reset(seed, task)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the policy's action, float32 (A,), for the observation with other forces."""
        felt, touch = observation["touch"][FORCES].copy(), observation["touch"].copy()
        if self._given is None:
            touch[FORCES] = felt if self._before is None else self._before
        else:
            touch[FORCES] = self._given[self._step] if self._step < len(self._given) else 0.0
        self._step, self._before = self._step + 1, felt
        return self._policy.act({**observation, "touch": touch})


@dataclass(frozen=True)
class Changed:
    """A policy whose forces are changed, as a worker makes it: "felt", "late", or from a list."""

    plan: Plan
    policy: PolicySource
    forces: str | ForcesBySeed = "felt"

    def make_policy(self, _role: Role, _world_of: WorldOf) -> Policy:
        """Return the policy of an episode."""
        policy = load_policy(self.policy)
        if self.forces == "felt":
            return policy
        return OtherForces(policy, None if isinstance(self.forces, str) else self.forces)


def play_changed(
    felt: Changed, specs: list[EpisodeSpec], calm: list[PlayedEpisode], way: str
) -> list[PlayedEpisode]:
    """Play episodes with the forces of a way of WORDS, in a process as evaluations use it.

    "other": those felt in the undisturbed play ``calm`` of the episode before; the first episode
    has those of the last one.
    """
    forces: str | ForcesBySeed = way
    if way == "other":
        others = [calm[-1], *calm[:-1]]
        forces = {
            spec.policy_seed: other.trace.touch[:-1, FORCES]
            for spec, other in zip(specs, others, strict=True)
        }
    return [*LocalEngine(1).run(replace(felt, forces=forces), specs)]


def reliance_rows(final: Path, run: mt.Run, asked: Mapping[str, Any]) -> dict[str, pd.DataFrame]:
    """Play the first episodes of a run in each way that a design asks for.

    Returns:
        Rows of ``episodes`` and ``estimates``, with the columns of the grid's, without its key.

    Raises:
        MiniTouchError: an undisturbed episode has other bits than in the run.
    """
    source = replace(parse_source(str(final)), content=final.read_bytes())
    felt = Changed(run.plan, source)
    specs = [spec for spec in run.header.specs() if spec.role is Role.FINAL][: asked["episodes"]]
    calm = [*LocalEngine(1).run(felt, specs)]
    if [measure(one).digest for one in calm] != [row.digest for row in run.rows[: len(specs)]]:
        raise mt.MiniTouchError(f"{final} does not play the episodes of {run.name} again")
    episodes, estimates = [], []
    for way in asked["forces"]:
        played = [measure(one) for one in play_changed(felt, specs, calm, way)]
        frame = episodes_frame(played).drop(columns=["task", "digest"])
        episodes.append(frame.assign(suite=run.plan.suite, conditions=WORDS[way], role="final"))
        values = asdict(wilson(sum(one.success for one in played), len(played)))
        interval, count = values.pop("method"), values.pop("count")
        named = {"suite": run.plan.suite, "conditions": WORDS[way], "metric": "success"}
        estimates.append({**named, **values, "episodes": count, "interval": interval})
    return {"episodes": pd.concat(episodes), "estimates": pd.DataFrame(estimates)}
