"""From what a user typed to policies that are held as asked."""

import os
from typing import NamedTuple

from minitouch_bench.cli.consoles import notes
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.engine import Contest
from minitouch_bench.policies.holding import probe
from minitouch_bench.policies.isolation.levels import Isolation
from minitouch_bench.policies.process import PolicyLimits
from minitouch_bench.policies.sources import PolicySource, parse_source
from minitouch_bench.protocol.minitouch import GOAL_TASKS

MAX_WORKERS = 1024
AUTO = "auto"


class Holding(NamedTuple):
    """How policies are held."""

    limits: PolicyLimits
    isolation: Isolation
    trust: bool


def make_contest(
    policy: str, exploration: str | None, tasks: tuple[str, ...], holding: Holding
) -> Contest:
    """Find the policies and load each once, so that a bad file is refused before any episode."""
    limits, isolation, trust = holding
    if isolation is Isolation.NONE and not trust:
        raise UsageError("--isolation none runs the policy in this very process: add --trust")
    source = _find_policy(policy, tasks, holding)
    if exploration is None:
        return Contest(source, limits=limits, trust=trust, isolation=isolation)
    goals = tuple(task for task in tasks if task in GOAL_TASKS)
    if not goals:
        raise UsageError("--exploration needs a task with a goal: " + ", ".join(GOAL_TASKS))
    explorer = _find_policy(exploration, goals, holding, deterministic=False)
    return Contest(source, explorer, limits, trust, isolation)


def _find_policy(
    text: str, tasks: tuple[str, ...], holding: Holding, *, deterministic: bool = True
) -> PolicySource:
    limits, isolation, trust = holding
    source = parse_source(text, tasks, trust=trust)
    if source.kind == "remote" and isolation is Isolation.SANDBOX:
        notes.print(
            "a policy server needs the network: its client is held at level process", markup=False
        )
    probe(source, tasks, limits, isolation, deterministic=deterministic, trust=trust)
    return source


def worker_count(text: str) -> int:
    """Return the number of workers; "auto" is one a core that this process may use."""
    if text == AUTO:
        return len(os.sched_getaffinity(0))
    if not text.isdecimal() or not 1 <= int(text) <= MAX_WORKERS:
        raise UsageError(f"--workers is a number from 1 to {MAX_WORKERS}, or auto, not '{text}'")
    return int(text)
