"""What a finished policy does with other forces than those that its fingers feel."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import minitouch_bench as mt
from minitouch_bench.episode import EpisodeSpec, PlayedEpisode, Role
from minitouch_bench.evaluation.rollout import run_episode
from minitouch_bench.metrics.intervals import wilson
from minitouch_bench.metrics.summary import episodes_frame, measure
from minitouch_bench.policies.policy import Observation, Policy, load_policy
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.simulation.observation import FORCES
from minitouch_bench.tasks.environment import MiniTouchEnv

WORDS = {"late": "forces of one step before", "other": "forces of another episode"}
"""What the rows of each way say in their column ``conditions``."""


class OtherForces:
    """A policy that is given the forces of a list, one row per control step, and then 0 N.

    ``forces`` None: those of one control step before, in the first step those of the reset.
    """

    def __init__(self, policy: Policy, forces: NDArray[np.float32] | None = None) -> None:
        self._policy, self._forces = policy, forces

    def reset(self, seed: int, task: str) -> None:
        """Begin an episode."""
        self._step, self._before = 0, None
        self._policy.reset(seed, task)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the policy's action, float32 (A,), for the observation with other forces."""
        felt, touch = observation["touch"][FORCES].copy(), observation["touch"].copy()
        if self._forces is None:
            touch[FORCES] = felt if self._before is None else self._before
        else:
            touch[FORCES] = self._forces[self._step] if self._step < len(self._forces) else 0.0
        self._step, self._before = self._step + 1, felt
        return self._policy.act({**observation, "touch": touch})


def play(
    policy: Policy, environment: MiniTouchEnv, specs: Sequence[EpisodeSpec], way: str
) -> list[PlayedEpisode]:
    """Play episodes with the forces of a way of WORDS; "other": of the episode before in the list.

    The first episode has those of the last one. They are the forces felt in an undisturbed play.
    """
    if way == "late":
        return [run_episode(environment, OtherForces(policy), spec) for spec in specs]
    calm = [run_episode(environment, policy, spec).trace.touch[:, FORCES] for spec in specs]
    others = [calm[-1], *calm[:-1]]
    return [
        run_episode(environment, OtherForces(policy, forces), spec)
        for spec, forces in zip(specs, others, strict=True)
    ]


def reliance_rows(final: Path, run: mt.Run, asked: Mapping[str, Any]) -> dict[str, pd.DataFrame]:
    """Play the first episodes of a run in each way that a design asks for.

    Returns:
        Rows of ``episodes`` and ``estimates``, with the columns of the grid's, without its key.
    """
    (task,) = run.tasks
    source = replace(parse_source(str(final)), content=final.read_bytes())
    policy, environment = load_policy(source), MiniTouchEnv(task)
    specs = [spec for spec in run.header.specs() if spec.role is Role.FINAL][: asked["episodes"]]
    episodes, estimates = [], []
    for way in asked["forces"]:
        played = [measure(one) for one in play(policy, environment, specs, way)]
        frame = episodes_frame(played).drop(columns=["task", "digest"])
        episodes.append(frame.assign(suite="table4", conditions=WORDS[way], role="final"))
        values = asdict(wilson(sum(one.success for one in played), len(played)))
        interval, count = values.pop("method"), values.pop("count")
        named = {"suite": "table4", "conditions": WORDS[way], "metric": "success"}
        estimates.append({**named, **values, "episodes": count, "interval": interval})
    environment.close()
    return {"episodes": pd.concat(episodes), "estimates": pd.DataFrame(estimates)}
