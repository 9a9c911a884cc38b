"""Runs of some tasks each, joined into the run that one evaluation of all of them would be."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from minitouch_bench.errors import UsageError
from minitouch_bench.files import ACTIONS_FILE, RUN_FILE, write_file
from minitouch_bench.records import PolicyIdentity
from minitouch_bench.runs.actions import pack_arrays
from minitouch_bench.runs.plan import find_suite
from minitouch_bench.runs.run import (
    Run,
    RunEnvironment,
    make_header,
    run_digest,
    run_json,
)


def join_runs(
    runs: Sequence[Run],
    policy: PolicyIdentity,
    exploration: PolicyIdentity | None,
    directory: Path,
) -> None:
    """Write the joined run.

    An episode and its estimates do not depend on the other tasks of a run, so nothing is played or
    estimated again. A package or fact of the machine that is not equal in all runs is "several".

    Args:
        runs: They differ in their tasks, policies and machines alone.
        policy: What the joined run records; its files are those of the runs.
        exploration: The same of the exploration policies; None leaves their episodes out.
        directory: Where ``run.json`` and ``actions.npz`` are written.

    Raises:
        UsageError: the runs have other differences, a task twice, or other rules than today's, or
            one was edited.
        RunDirectoryError: a file cannot be read or written.
    """
    first = runs[0]
    by_task = {task: run for run in runs for task in run.plan.tasks}
    tasks = tuple(task for task in find_suite(first.plan.suite).tasks if task in by_task)
    plan = replace(first.plan, tasks=tasks)
    header = make_header(plan, policy, exploration, first.header.isolation)
    if sum(len(run.plan.tasks) for run in runs) > len(tasks):
        raise UsageError("two of the runs have the same task")
    for run in runs:
        if (replace(run.plan, tasks=tasks), run.header.isolation) != (plan, header.isolation):
            raise UsageError(f"{run.name} and {first.name} have different plans")
        if other := header.rules_differ(run.header):
            raise UsageError(f"{run.name} has other rules of {other[0]} than today's protocol")
        if run.is_edited():
            raise UsageError(f"{run.name} was edited: its digest is not that of its episodes")
    episodes, explored = (
        tuple(row for task in tasks for row in getattr(by_task[task], rows) if row.task == task)
        for rows in ("episodes", "exploration_episodes")
    )
    if exploration is None:
        explored = ()
    faults = {key: fault for run in runs for key, fault in run.faults.items()}
    parts = {part.task: part for run in runs for part in run.summary.tasks}
    gaps = {part.task: part for run in runs for part in run.summary.generalization}
    joined = replace(
        first,
        digest=run_digest(header, episodes, explored),
        header=header,
        environment=_join_environments([run.environment for run in runs]),
        summary=replace(
            first.summary,
            tasks=tuple(parts[task] for task in tasks),
            generalization=tuple(gaps[task] for task in tasks if task in gaps),
        ),
        faults={spec.key: faults[spec.key] for spec in header.specs() if spec.key in faults},
        episodes=episodes,
        exploration_episodes=explored,
    )
    actions = {key: array for run in runs for key, array in run.actions.items()}
    in_order = {spec.key: actions[spec.key] for spec in header.specs()}
    write_file(directory / ACTIONS_FILE, pack_arrays(in_order))
    write_file(directory / RUN_FILE, run_json(joined))


def _join_environments(parts: Sequence[RunEnvironment]) -> RunEnvironment:
    return RunEnvironment(
        packages=_in_common([part.packages for part in parts]),
        machine=_in_common([part.machine for part in parts]),
        workers=max(part.workers for part in parts),
        started=min(part.started for part in parts),
        wall_s=round(sum(part.wall_s for part in parts), 3),
    )


def _in_common(parts: Sequence[Mapping[str, str]]) -> dict[str, str]:
    names = dict.fromkeys(name for part in parts for name in part)
    values = {name: {part.get(name, "") for part in parts} for name in names}
    return {name: found.pop() if len(found) == 1 else "several" for name, found in values.items()}
