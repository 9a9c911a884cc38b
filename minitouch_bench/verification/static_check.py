"""What a check finds, and a run checked by itself: its plan, its episodes, what follows from them.

No episode is played. What ``run.json`` says is computed again from its episodes and compared.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice, zip_longest
from operator import attrgetter
from typing import Any

import numpy as np

from minitouch_bench import errors
from minitouch_bench.episode import IN_MEMORY, Episode, Outcome, episode_key
from minitouch_bench.errors import plain_line
from minitouch_bench.files import ACTIONS_FILE, RUN_FILE
from minitouch_bench.json_io import plain
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.summary import TaskResult, summarize
from minitouch_bench.policies.policy import Isolation
from minitouch_bench.protocol.minitouch import PROTOCOL, SUITE_NAMES
from minitouch_bench.runs.actions import Actions
from minitouch_bench.runs.plan import first_of
from minitouch_bench.runs.run import NAMED, Run, RunHeader, make_header, run_digest, run_json

# What a check finds

SHOWN_CHARACTERS = 400
"""Characters of one part of a problem; a stranger's text never fills the screen."""

NEARLY_ZERO = 1e-12
"""Two smaller estimates are equal: a difference of means leaves such a rest."""
VALUE_CHARACTERS = 60
"""Characters of a value in a difference."""
ROUNDING = 1e-9
"""Relative difference of an estimate that another processor's arithmetic explains."""


@dataclass(frozen=True)
class Problem:
    """One problem: the file or key, what is wrong there, and what to do about it.

    ``place`` is "" for the whole directory.
    ``is_other_protocol``: the run is of another protocol, which is no mistake of its maker.
    ``is_unchecked``: a file could not be read here, so that nothing is known of it.
    """

    place: str
    what: str
    remedy: str = ""
    is_other_protocol: bool = False
    is_unchecked: bool = False

    def __str__(self) -> str:
        place = f"{plain_line(self.place, SHOWN_CHARACTERS)}: " if self.place else ""
        remedy = f"; {plain_line(self.remedy, SHOWN_CHARACTERS)}" if self.remedy else ""
        return f"{place}{plain_line(self.what, SHOWN_CHARACTERS)}{remedy}"


@dataclass(frozen=True)
class Findings:
    """What a check found: its problems, and how many episodes it played.

    ``replayed``: from their recorded actions; ``reran``: with the checkpoint.
    """

    problems: tuple[Problem, ...] = ()
    replayed: int = 0
    reran: int = 0

    @property
    def passed(self) -> bool:
        """Whether everything is as recorded."""
        return not self.problems


class Problems(dict[Problem, None]):
    """The problems found so far, in order; a check goes on after the first one."""

    def add(self, place: str, what: str, remedy: str = "", *, unchecked: bool = False) -> None:
        """Keep a problem; equal ones count once."""
        self[Problem(place, what, remedy, is_unchecked=unchecked)] = None

    def add_below(self, place: str, problems: Iterable[Problem], remedy: str = "") -> None:
        """Keep the problems of something that lies at ``place``, with a remedy of all."""
        for one in problems:
            moved = replace(one, place=f"{place}, {one.place}", remedy=remedy or one.remedy)
            self[moved] = None

    @contextmanager
    def caught(self, place: str, remedy: str = "") -> Iterator[None]:
        """Keep what the block's errors say of files and policies, and go on; other errors pass."""
        try:
            yield
        except errors.UnreadableFileError as error:
            self.add(place, str(error), unchecked=True)
        except (errors.UsageError, errors.PolicyError, errors.RunDirectoryError) as error:
            self.add(place, str(error).replace("\n", " "), remedy)


def compare_values(path: str, recorded: Any, computed: Any) -> Iterator[Problem]:
    """Yield each place where two JSON values differ; estimates may differ by ROUNDING."""
    if isinstance(recorded, Mapping) and isinstance(computed, Mapping):
        for key in dict.fromkeys([*recorded, *computed]):
            inner = f"{path}.{key}" if path else str(key)
            if key not in recorded or key not in computed:
                yield Problem(inner, "missing" if key in computed else "should not be there")
            else:
                yield from compare_values(inner, recorded[key], computed[key])
    elif isinstance(recorded, list | tuple) and isinstance(computed, list | tuple):
        if len(recorded) != len(computed):
            yield Problem(path, f"{len(recorded)} entries recorded, {len(computed)} found")
        else:
            for index, pair in enumerate(zip(recorded, computed, strict=True)):
                yield from compare_values(f"{path}[{index}]", *pair)
    elif not _equal(recorded, computed):
        then, now = (plain_line(repr(value), VALUE_CHARACTERS) for value in (recorded, computed))
        yield Problem(path, f"{then} recorded, {now} found")


def _equal(recorded: Any, computed: Any) -> bool:
    if isinstance(recorded, float) and isinstance(computed, float):
        return math.isclose(recorded, computed, rel_tol=ROUNDING, abs_tol=NEARLY_ZERO)
    return bool(recorded == computed)


# The check of a run

IDENTITY = attrgetter("task", "index", "seed", "shape", "family", "split")
"""What the suite fixes of an episode."""
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
    if mistake := header.plan.mistake():
        yield Problem("header.plan", mistake, RUN_AGAIN)
        return
    expected = make_header(header.plan, header.policy, header.exploration, header.isolation)
    for difference in compare_values("header", plain(header), plain(expected)):
        yield replace(difference, remedy=AS_WRITTEN)
    if what := _isolation_mistake(header):
        yield Problem("header.isolation", what, AS_WRITTEN)


def _isolation_mistake(header: RunHeader) -> str:
    """Return why no policies of these kinds ran at the recorded level of isolation, or ""."""
    if header.isolation not in tuple(Isolation):
        return "there is no such level of isolation"
    kinds = {policy.kind for policy in header.policies()}
    if kinds & {"scripted", IN_MEMORY} and header.isolation != Isolation.NONE:
        return f"it is {header.isolation}; a scripted policy and one in memory have none"
    if kinds == {"remote"} and header.isolation == Isolation.SANDBOX:
        return "it is sandbox; a policy server's client needs the network"
    return ""


def _episodes(run: Run) -> Iterator[Problem]:
    """Compare the rows of both roles with the episodes of the plan, in their order."""
    specs = run.header.specs()
    for role, rows in run.by_role():
        planned = [spec for spec in specs if spec.role is role]
        pairs = zip_longest(map(IDENTITY, planned), map(IDENTITY, rows))
        if other := next((spec or row for spec, row in pairs if spec != row), None):
            what = "from here the episodes are not the suite's, in its order, seeds and shapes"
            counts = f"{len(rows)} recorded of {len(planned)}"
            yield Problem(episode_key(role, *other[:2]), f"{what} ({counts})", RUN_AGAIN)


def _rows(run: Run) -> Iterator[Problem]:
    """Yield the first NAMED episodes that contradict themselves."""
    bad = ((spec, next(contradictions(row), "")) for spec, row in run.specs_and_rows())
    found = (Problem(spec.key, what, AS_WRITTEN) for spec, what in bad if what)
    yield from islice(found, NAMED)


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
    if run.digest != run_digest(run.header, run.rows, run.exploration_rows):
        yield Problem("digest", "it is not that of the episodes", AS_WRITTEN)
    if run.content and run.content != run_json(run):
        what = "it was edited or formatted again, or a key in it is unknown or there twice"
        yield Problem(RUN_FILE, what, AS_WRITTEN)


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
            raise errors.UsageError(f"{run.directory}: {problem.what}: make the run again")
        raise errors.RunDirectoryError(f"{run.directory} was edited or damaged.\n{problem}")
    return run


def refuse_unplayable(run: Run) -> None:
    """Refuse a run whose episodes cannot be played here.

    Raises:
        UsageError: its protocol, its plan or its episodes are not this installation's.
        RunDirectoryError: its actions are missing or damaged.
    """
    for problem in check_plan(run):
        raise errors.UsageError(f"{run.directory or run.name} cannot be replayed.\n{problem}")
