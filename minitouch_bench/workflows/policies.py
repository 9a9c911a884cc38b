"""Find the policies of a run and try each before its first episode."""

from dataclasses import replace
from pathlib import Path

from minitouch_bench.conditions import STANDARD, Conditions
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.policies.in_memory import keep_in_memory
from minitouch_bench.policies.isolate import effective_level, try_policy
from minitouch_bench.policies.isolation.options import SANDBOXED, Isolation, IsolationOptions
from minitouch_bench.policies.sources import PolicySource, parse_source
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.workflows import SILENT, Callbacks


def prepare_policies(
    policy: object,
    tasks: tuple[str, ...],
    isolation: IsolationOptions = SANDBOXED,
    callbacks: Callbacks = SILENT,
    *,
    exploration: object | None = None,
    name: str | None = None,
    conditions: Conditions = STANDARD,
) -> PolicySetup:
    """Find the policies and load each once, so that a bad file is refused before any episode.

    A policy is what the command line takes, or an object. ``name`` is what reports call the
    policy; by default its own name.

    Raises:
        UsageError: an option has no meaning here.
        PolicyError, IsolationError, MissingExtraError: a policy cannot be used.
    """
    if isolation.level is Isolation.NONE and not isolation.trust:
        raise UsageError("--isolation none runs the policy in this very process: add --trust")
    source = _find_policy(policy, tasks, isolation, callbacks)
    if source.kind == "scripted" and conditions.change_the_senses:
        raise UsageError("the scripted policy has no senses to change: it reads the simulator")
    if name is not None:
        source = replace(source, name=name)
    if exploration is None:
        return PolicySetup(source, isolation=isolation, conditions=conditions)
    goals = tuple(task for task in tasks if task in GOAL_TASKS)
    if not goals:
        raise UsageError("--exploration needs a task with a goal: " + ", ".join(GOAL_TASKS))
    explorer = _find_policy(exploration, goals, isolation, callbacks, deterministic=False)
    return PolicySetup(source, explorer, isolation, conditions)


def _find_policy(
    policy: object,
    tasks: tuple[str, ...],
    isolation: IsolationOptions,
    callbacks: Callbacks,
    *,
    deterministic: bool = True,
) -> PolicySource:
    if isinstance(policy, str | Path):
        source = parse_source(str(policy), tasks, trust=isolation.trust)
    else:
        source = keep_in_memory(policy)
    level = effective_level(source, isolation.level)
    if source.kind == "remote" and level is not isolation.level:
        callbacks.note(f"a policy server needs the network: its client has isolation {level}")
    try_policy(source, tasks, isolation, deterministic=deterministic)
    return source
