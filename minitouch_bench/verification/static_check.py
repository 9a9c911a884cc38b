"""A run checked by itself: its plan, its episodes, and all that follows from them.

No episode is played. What ``run.json`` says is computed again from its episodes and compared.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from minitouch_bench.episode import IN_MEMORY, Episode, EpisodeSpec, Outcome, episode_key
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.files import ACTIONS_FILE, RUN_FILE
from minitouch_bench.json_io import plain
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.summary import TaskResult, summarize
from minitouch_bench.policies.policy import Isolation
from minitouch_bench.protocol.minitouch import PROTOCOL, SUITE_NAMES
from minitouch_bench.runs.actions import Actions
from minitouch_bench.runs.plan import first_of
from minitouch_bench.runs.run import NAMED, Run, RunHeader, run_json, why_unofficial
from minitouch_bench.verification.problems import Problem, compare_values

IDENTITY = ("seed", "shape", "family", "split")
"""What the suite fixes of an episode, beside its task and index."""
RUN_AGAIN = "evaluate again with this version of minitouch-bench"
AS_WRITTEN = "take the run as it was written"

CURVE_TOLERANCE = 1e-6
"""Relative rounding of a sum over a touch curve's means."""


def check_run(
    run: Run, *, recompute: bool = True, unpack_actions: bool = True
) -> tuple[Problem, ...]:
    """Return every problem of a run, of its episodes and of what is said of them.

    What follows from its episodes is looked at where they are those of its plan, and possible, and
    unedited. Without ``recompute`` estimates are not computed again, and actions not unpacked: for
    bytes that a proof is about. Without ``unpack_actions`` only ``run.json`` is looked at.

    Raises:
        UnreadableFileError: its actions cannot be read.
        RunDirectoryError: they are damaged.
    """
    if problems := check_plan(run):
        return problems
    problems = (*_rows(run), *_faults(run), *_digest(run))
    if problems or not recompute:
        return problems
    return (*_estimates(run), *(_actions(run) if unpack_actions else ()))


def check_plan(run: Run) -> tuple[Problem, ...]:
    """Return the problems for which a run's episodes cannot be known or are not the plan's."""
    return tuple(_protocol(run.header)) or tuple(_settings(run.header)) or tuple(_episodes(run))


def _protocol(header: RunHeader) -> Iterator[Problem]:
    """Compare the digest of each task with this installation's."""
    plan = header.plan
    if plan.suite not in SUITE_NAMES:
        return  # which _settings says
    rules = plan.rules()
    other = [task for task, digest in rules.items() if header.task_digests.get(task) != digest]
    if other:
        recorded, here = header.task_digests.get(other[0], ""), rules[other[0]]
        yield Problem(
            "protocol",
            f"the rules of {', '.join(other)} are not this installation's ({other[0]}: "
            f"{recorded[:12] or 'none'} recorded, {here[:12]} here)",
            RUN_AGAIN,
            is_other_protocol=True,
        )


def _settings(header: RunHeader) -> Iterator[Problem]:
    """Compare what the header says of the run with the suite that it names."""
    name, mistake = header.plan.mistake()
    if name:
        yield Problem(f"header.plan.{name}", mistake, RUN_AGAIN)
        return
    reasons = why_unofficial(header.plan, header.policy, header.exploration, header.isolation)
    if header.unofficial_because != reasons:
        given, right = (
            "; ".join(listed) or "none" for listed in (header.unofficial_because, reasons)
        )
        what = f"the reasons given are {given}, the plan gives {right}"
        yield Problem("header.unofficial_because", what, AS_WRITTEN)
    if header.official == bool(reasons):
        yield Problem("header.official", f"it is {header.official}", AS_WRITTEN)
    if header.protocol != PROTOCOL.name:
        yield Problem("header.protocol", f"it is not {PROTOCOL.name}", AS_WRITTEN)
    if header.protocol_digest != PROTOCOL.digest():
        yield Problem("header.protocol_digest", f"it is not that of {PROTOCOL.name}", AS_WRITTEN)
    if what := _isolation_mistake(header):
        yield Problem("header.isolation", what, AS_WRITTEN)
    if header.task_digests.keys() != set(header.plan.tasks):
        yield Problem("header.task_digests", "they are not of the plan's tasks", AS_WRITTEN)


def _isolation_mistake(header: RunHeader) -> str:
    """Return why no policies of these kinds ran at the recorded level of isolation, or ""."""
    if header.isolation not in tuple(Isolation):
        return "there is no such level of isolation"
    kinds = {policy.kind for policy in header.policies()}
    if kinds & {"scripted", IN_MEMORY} and header.isolation != Isolation.NONE:
        return f"it is {header.isolation}; a scripted policy and one in memory have none"
    if "remote" in kinds and header.isolation == Isolation.SANDBOX:
        return "it is sandbox; a policy server's client needs the network"
    return ""


def _episodes(run: Run) -> Iterator[Problem]:
    """Compare the rows of both roles with the episodes of the plan."""
    specs = run.header.specs()
    for role, rows in run.by_role():
        planned = {(spec.task, spec.index): spec for spec in specs if spec.role is role}
        counts = Counter((row.task, row.index) for row in rows)
        missing = [spec.key for key, spec in planned.items() if key not in counts]
        twice = [episode_key(role, *key) for key, count in counts.items() if count > 1]
        unknown = [episode_key(role, *key) for key in counts if key not in planned]
        yield from _named(missing, "missing", "evaluate the whole suite")
        yield from _named(twice, "there twice", AS_WRITTEN)
        yield from _named(unknown, "not of the suite", AS_WRITTEN)
        if not (missing or twice or unknown):
            yield from _in_order(rows, tuple(planned.values()))


def _in_order(rows: Sequence[Episode], planned: Sequence[EpisodeSpec]) -> Iterator[Problem]:
    """Compare the rows, each of which is there once, with their order and what each must be."""
    moved = [
        spec.key
        for row, spec in zip(rows, planned, strict=True)
        if (row.task, row.index) != (spec.task, spec.index)
    ]
    if moved:
        yield from _named(moved, "not in the suite's order", AS_WRITTEN)
        return
    for name in IDENTITY:
        other = [
            spec.key
            for row, spec in zip(rows, planned, strict=True)
            if getattr(row, name) != getattr(spec, name)
        ]
        yield from _named(other, f"with another {name} than the suite's", RUN_AGAIN)


def _named(keys: Sequence[str], what: str, remedy: str) -> Iterator[Problem]:
    """Name the first few episodes that share a problem, and count the rest."""
    if keys:
        count = f"{len(keys)} episode{'s are' if len(keys) > 1 else ' is'} {what}"
        yield Problem(keys[0], f"{count}: {first_of(keys, NAMED)}", remedy)


def _rows(run: Run) -> Iterator[Problem]:
    """Yield what no episode can be; the same kind of contradiction a few times."""
    for role, rows in run.by_role():
        bad = [(row, what) for row in rows if (what := next(contradictions(row), ""))]
        for row, what in bad[:NAMED]:
            yield Problem(episode_key(role, row.task, row.index), what, AS_WRITTEN)
        if len(bad) > NAMED:
            yield Problem(str(role), f"{len(bad)} episodes contradict themselves", AS_WRITTEN)


def contradictions(row: Episode) -> Iterator[str]:
    """Yield what cannot be true of one episode, in words."""
    task = PROTOCOL.task(row.task)
    if row.outcome is Outcome.SUCCESS and not task.has_goal:
        yield f"{row.task} has no goal and cannot succeed"
    if row.outcome is Outcome.LEFT_WORKSPACE and not task.object_can_leave:
        yield f"in {row.task} nothing can leave the workspace"
    if row.outcome is Outcome.STEP_LIMIT and row.steps != task.max_steps:
        yield f"it ended at the step limit after {row.steps} of {task.max_steps} steps"
    for metric in METRICS.values():
        if what := metric.contradiction(row):
            yield what


def _faults(run: Run) -> Iterator[Problem]:
    """Compare the texts of policy faults with the episodes that ended in one."""
    failed = {spec.key for spec, row in run.specs_and_rows() if row.outcome is Outcome.POLICY_FAULT}
    if failed != set(run.faults):
        other = sorted(failed ^ set(run.faults))
        what = f"faults and outcomes differ in {', '.join(other[:NAMED])}"
        yield Problem("faults", what, AS_WRITTEN)


def _digest(run: Run) -> Iterator[Problem]:
    if run.is_edited():
        yield Problem("digest", "it is not that of the episodes", AS_WRITTEN)
    if run.content and run.content != run_json(run):
        yield Problem(RUN_FILE, "a key is there twice or unknown, or it was edited", AS_WRITTEN)


def _estimates(run: Run) -> Iterator[Problem]:
    """Compute every estimate from the episodes, with the run's own random stream."""
    plan, tasks = run.plan, run.summary.tasks
    expected = summarize(plan.tasks, run.rows, run.exploration_rows, plan.seed)
    curveless = (replace(task, touch_curve=(), touch_curve_episodes=()) for task in tasks)
    recorded = replace(run.summary, tasks=tuple(curveless))
    differences = compare_values("summary", plain(recorded), plain(expected))
    # A few of them: one edited figure shows in several places.
    later = tuple(f".{metric.name}" for metric in METRICS.values() if metric.added_later)
    wrong = (
        one for one in differences if not (one.what == "missing" and one.place.endswith(later))
    )
    for difference in islice(wrong, 2 * NAMED):
        yield replace(difference, remedy=AS_WRITTEN)
    for task in tasks:
        if what := _curve_mistake(task, [e for e in run.rows if e.task == task.task]):
            yield Problem(f"touch curve of {task.task}", what, AS_WRITTEN)


def _curve_mistake(task: TaskResult, episodes: list[Episode]) -> str:
    """Return what is wrong with a touch curve, as far as rows can tell, "" if nothing."""
    steps = np.array([episode.steps for episode in episodes], np.int64)
    longest = int(steps.max(initial=0))
    reached = [int((steps > step).sum()) for step in range(longest)]
    if list(task.touch_curve_episodes) != reached or len(task.touch_curve) != longest:
        return "it is not over the episodes that reached each step"
    if not all(0 <= ticks <= PROTOCOL.control.max_ticks for ticks in task.touch_curve):
        return f"a control step has 0 to {PROTOCOL.control.max_ticks} ticks"
    total = float(np.dot(task.touch_curve, reached)) if reached else 0.0
    expected = sum(episode.touch_interaction for episode in episodes)
    if abs(total - expected) > CURVE_TOLERANCE * max(1, expected):
        return f"it adds up to {total:.0f} ticks, the episodes to {expected}"
    return ""


def _actions(run: Run) -> Iterator[Problem]:
    """Check that every episode has its actions, as many as it has steps."""
    missing = [spec.key for spec in run.header.specs() if spec.key not in run.actions]
    if missing:
        what = f"the actions of {len(missing)} episodes are missing: {first_of(missing, NAMED)}"
        yield Problem(ACTIONS_FILE, what, AS_WRITTEN)
    for spec, row in run.specs_and_rows():
        if spec.key in run.actions and (what := _actions_mistake(run.actions[spec.key], row)):
            yield Problem(f"{ACTIONS_FILE}, {spec.key}", what, AS_WRITTEN)


def _actions_mistake(actions: Actions, row: Episode) -> str:
    """Return what is wrong with an episode's actions, "" if nothing."""
    if len(actions) != row.steps:
        return f"{len(actions)} actions, the episode has {row.steps} steps"
    # The recorded actions are as applied: a clipped one stands at a bound.
    at_bounds = int((np.abs(actions) == 1).any(axis=1).sum())
    if row.clipped_actions > at_bounds:
        return f"{row.clipped_actions} are said to be clipped, {at_bounds} are at a bound"
    return ""


def refuse_edited(run: Run) -> Run:
    """Refuse a stored run that cannot have been written as it is, as far as its files say so.

    Its digest does not cover every number of an episode, so the estimates are computed again, and
    the actions counted where they are kept. Only ``replay_run`` finds numbers that were changed
    in every place where they are written. How ``run.json`` is formatted does not matter: a
    repository's hooks may format it.

    Raises:
        RunDirectoryError: it was edited, or its actions are damaged.
        UsageError: it was played by other rules than this installation's.
    """
    assert run.directory is not None
    has_actions = (run.directory / ACTIONS_FILE).exists()
    for problem in check_run(replace(run, content=b""), unpack_actions=has_actions):
        if problem.is_other_protocol:
            raise UsageError(f"{run.directory}: {problem.what}: make the run again")
        raise RunDirectoryError(f"{run.directory} was edited or damaged.\n{problem}")
    return run


def refuse_unplayable(run: Run) -> None:
    """Refuse a run whose episodes cannot be played here.

    Raises:
        UsageError: its protocol, its plan or its episodes are not this installation's.
        RunDirectoryError: its actions are missing or damaged.
    """
    for problem in check_plan(run):
        raise UsageError(f"{run.directory or run.name} cannot be replayed.\n{problem}")
