"""How runs, tasks and values are written: names, what must be said beside them, and the paper's.

Source of the paper's values: "Haptics-based Curiosity for Sparse-reward Tasks", CoRL 2021,
supplement, Table 4.
"""

import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from minitouch_bench.episode import IN_MEMORY
from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.intervals import Estimate
from minitouch_bench.protocol.minitouch import PROTOCOL, TASK_NAMES
from minitouch_bench.reporting.charts import draw_gauge
from minitouch_bench.reporting.tables import Cell
from minitouch_bench.runs.run import Run, RunHeader, is_weakly_isolated
from minitouch_bench.text import numbered, printable

CITATION = "“Haptics-based Curiosity for Sparse-reward Tasks”, CoRL 2021, supplement, Table 4"
CAVEAT = "other episodes and object sets"

PAPER_TASKS = ("pushing", "opening", "pick-up", "playing")
"""The tasks in the order of Table 4."""

PAPER_METHODS = ("HaC", "RND+touch", "RND")
"""The columns of Table 4. Its Pick-up block prints "HaC-RND" over the second one, which the
caption and the text describe as RND+touch."""

OTHER_UNIT = "other unit"
"""Marks a value whose unit the paper does not state."""

MARK = "†"
"""Stands behind such a value in tables, where there is no room for more."""

PAPER_NOTE = f"{', '.join(PAPER_METHODS)}: the paper's own values, {CAVEAT} ({CITATION})."
"""Printed below every table with values of the paper."""

MARK_NOTE = (
    f"{MARK} {OTHER_UNIT}: the paper does not say what it counts, so it is compared with nothing."
)
"""Printed below every table with a MARK."""

METRICS_OF_UNKNOWN_UNIT = ("touch_interaction",)
"""No unit we tried reproduces the paper's values: random actions reach 550 to 990 ticks in the
released package, above the paper's best method in Playing."""

_PRINTED = {
    ("pushing", "exploration"): ("0.403", "0.181", "0.077"),
    ("opening", "exploration"): ("0.669", "0.564", "0.380"),
    ("pick-up", "exploration"): ("0.063", "0.013", "0.005"),
    ("pushing", "success"): ("0.733", "0.710", "0.582"),
    ("opening", "success"): ("0.983", "0.921", "0.875"),
    ("pick-up", "success"): ("0.891", "0.593", "0.450"),
    ("pushing", "episode_steps"): ("57.84", "55.20", "97.51"),
    ("opening", "episode_steps"): ("23.34", "23.54", "37.92"),
    ("pick-up", "episode_steps"): ("30.54", "52.29", "89.88"),
    ("pushing", "touch_interaction"): ("247.79", "227.75", "206.02"),
    ("opening", "touch_interaction"): ("600.1", "411.43", "194.22"),
    ("pick-up", "touch_interaction"): ("980.7", "894.5", "725.1"),
    ("playing", "touch_interaction"): ("388.15", "312.0", "124.5"),
}


def paper_value(task: str, metric: str, method: str) -> str:
    """Return a value of Table 4 as the paper prints it, "" where it gives none."""
    printed = _PRINTED.get((task, metric))
    return printed[PAPER_METHODS.index(method)] if printed else ""


def paper_cell(task: str, metric: str, method: str) -> Cell:
    """Write a value of the paper; one in another unit is marked, and no number to sort by."""
    text, title = paper_value(task, metric, method), "as printed in the paper"
    if metric in METRICS_OF_UNKNOWN_UNIT and text:
        return Cell(text + MARK, title=f"{title}, {OTHER_UNIT}")
    return Cell(text, title=title, sort_key=float(text)) if text else Cell()


# Values of metrics


def format_value(metric: str, value: float) -> str:
    """Write a value of a metric with the digits it deserves."""
    return format(value, METRICS[metric].number_format)


def metric_head(metric: str, task: str | None = None) -> str:
    """Name a metric with the arrow of its better direction, in one task or in all of them."""
    known = METRICS[metric]
    if task is None and known.task_directions:
        arrows = (f"{arrow} in {task_title(name)}" for name, arrow in known.task_directions.items())
        return f"{known.label} ({', '.join(arrows)})"
    return f"{known.label} {known.direction_in(task or '')}".rstrip()


def estimate_cell(metric: str, estimate: Estimate | None, mark: str = "") -> Cell:
    """Write an estimate with its interval, a share with a gauge and ``mark``; a dash for none."""
    if estimate is None:
        return Cell()
    cell = _interval_cell(estimate, METRICS[metric].number_format)
    return replace(cell, gauge=draw_gauge(estimate, mark)) if METRICS[metric].is_fraction else cell


def difference_cell(metric: str, difference: Estimate) -> Cell:
    """Write a difference with its sign and interval; what rounds to 0 has a plus."""
    return _interval_cell(difference, f"+z{METRICS[metric].number_format}")


def _interval_cell(estimate: Estimate, form: str) -> Cell:
    return Cell(
        f"{estimate.value:{form}}",
        f"[{estimate.low:{form}}, {estimate.high:{form}}]",
        f"{counted(estimate)}, 95 % interval: {estimate.method}",
        estimate.value,
    )


def counted(estimate: Estimate) -> str:
    """Say how many episodes or training seeds an estimate is over."""
    what = "training seed" if "training seeds" in estimate.method else "episode"
    return numbered(estimate.count, what)


# Runs


@dataclass(frozen=True)
class RunSection:
    """One run in a report, and what it is called there."""

    name: str
    run: Run

    @property
    def labels(self) -> tuple[str, ...]:
        """What a reader must know of the run."""
        return run_labels(self.run)

    @property
    def marked_name(self) -> str:
        """The name, with a * where a note below the table belongs to the run."""
        return f"{self.name}\u00a0*" if self.labels else self.name

    @property
    def faults(self) -> Mapping[str, Sequence[str]]:
        """The policy's faults, each with its episodes."""
        return group_faults(self.run.faults.items())

    @property
    def command(self) -> str:
        """The command line that repeats the run."""
        return reproduce_command(self.run.header)

    @property
    def episodes(self) -> str:
        """Which episodes of its suite the run has."""
        plan = self.run.plan
        if plan.chosen:
            return printable(f"episodes {', '.join(plan.chosen)}")
        return f"{numbered(plan.episodes, 'episode')} per task"


def describe_runs(
    runs: Sequence[Run], names: Sequence[str] | None = None
) -> tuple[RunSection, ...]:
    """Say what each run is called in a report: by ``names``, or by ``run_names``.

    Raises:
        UsageError: ``names`` are not as many as the runs, or not distinct.
    """
    named = run_names(runs) if names is None else tuple(map(printable, names))
    if len(named) != len(runs):
        raise UsageError(f"{len(named)} names for {len(runs)} runs; give one per run")
    if len(set(named)) < len(runs) or not all(named):
        raise UsageError(f"the names {', '.join(named)} do not distinguish the runs")
    return tuple(map(RunSection, named, runs))


def run_names(runs: Sequence[Run]) -> tuple[str, ...]:
    """Name each run by its policy until the names differ.

    Equal names are followed by the suite, if there are several, and by what differs from it, then
    by the run's own name, then by a number.
    """
    policies = names = [printable(run.header.policy.name) for run in runs]
    several = len({run.plan.suite for run in runs}) > 1
    differences = [
        ", ".join((*([f"suite {run.plan.suite}"] if several else []), *run.plan.differences()))
        for run in runs
    ]
    for details in (differences, [run.name for run in runs]):
        counts = Counter(names)
        names = [
            f"{policy} ({printable(detail)})" if detail and counts[name] > 1 else name
            for name, policy, detail in zip(names, policies, details, strict=True)
        ]
    counts = Counter(names)
    return tuple(
        name if counts[name] == 1 else f"{name} #{1 + names[:index].count(name)}"
        for index, name in enumerate(names)
    )


def group_faults(faults: Iterable[tuple[str, str]]) -> Mapping[str, Sequence[str]]:
    """Return the episodes of each fault by its text; ``faults``: episode and text."""
    episodes: dict[str, list[str]] = {}
    for key, text in faults:
        episodes.setdefault(printable(text), []).append(printable(key))
    return episodes


MUCH_CLIPPING = 0.5
"""Share of clipped actions above which a policy probably lacks a tanh, or has other units."""


def run_labels(run: Run) -> tuple[str, ...]:
    """Return what a reader must know of a run: notes, why it is unofficial, what went wrong."""
    header, faults = run.header, [*group_faults(run.faults.items())]
    labels = list(header.policy.notes)
    if is_dark(run):
        labels.append("light off: every image is black")
    if header.exploration is not None:
        labels += [
            f"exploration policy: {note}"
            for note in header.exploration.notes
            if note not in header.policy.notes
        ]
    if not header.official:
        labels.append(f"unofficial: {'; '.join(header.unofficial_because)}")
    if faults:
        more = ", and others" if len(faults) > 1 else ""
        labels.append(f"{numbered(len(run.faults), 'policy fault')}: {faults[0]}{more}")
    clipped = sum(row.clipped_actions for row in run.rows)
    share = clipped / max(1, sum(row.steps for row in run.rows))
    if share > MUCH_CLIPPING:
        labels.append(f"{share:.0%} of its actions were outside -1 to 1, and clipped")
    return tuple(printable(label) for label in labels)


def is_dark(run: Run) -> bool:
    """Tell whether a run's suite has the light off, and nothing of the run changes that."""
    return run.plan.conditions.light is None and PROTOCOL.suite(run.plan.suite).light == 0.0


TASKS = (*PAPER_TASKS, *(task for task in TASK_NAMES if task not in PAPER_TASKS))
"""Every task, in the order of every table: the paper's, others after them."""


def force_limits(tasks: Sequence[str]) -> str:
    """Say where the components of a force are cut off, as "±50 N (Pick-up ±200 N)"."""
    limits = {task: f"±{PROTOCOL.task(task).force_limit:g} N" for task in tasks}
    usual = max(limits.values(), key=[*limits.values()].count, default="")
    others = (f"{task_title(task)} {at}" for task, at in limits.items() if at != usual)
    return f"{usual}{''.join(f' ({other})' for other in others)}"


def force_note(tasks: Sequence[str]) -> str:
    """Say what peak and contact force are bounded by in these tasks."""
    return (
        "Peak and contact force: of the finger that feels more, in steps with contact. Each of a "
        f"force's three components is cut off at {force_limits(tasks)}: near it and above, a "
        "force was possibly larger."
    )


def listed(names: Sequence[str]) -> str:
    """Join names inside a sentence, as "a, b and c"."""
    return " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else "".join(names)


def task_title(task: str) -> str:
    """Return a task's name as a heading."""
    titles = (known.title for known in PROTOCOL.tasks if known.name == task)
    return next(titles, printable(task).capitalize())


def tasks_in_order(runs: Sequence[Run]) -> tuple[str, ...]:
    """Return the tasks that any of the runs has, in the paper's order."""
    present = {task.task for run in runs for task in run.summary.tasks if task.estimates}
    return tuple(task for task in TASKS if task in present)


def reproduce_command(header: RunHeader) -> str:
    """Return the command line that repeats a run; "" where there is none."""
    kinds = {policy.kind for policy in header.policies()}
    if IN_MEMORY in kinds or (header.plan.objects and header.plan.objects.are_listed):
        return ""
    words = ["minitouch-bench", "evaluate", header.policy.source, *header.plan.as_options()]
    if header.exploration is not None:
        words += ["--exploration", header.exploration.source]
    is_chosen = "scripted" not in kinds and is_weakly_isolated(kinds, header.isolation)
    if is_chosen:
        words += ["--isolation", header.isolation]
    if is_chosen or "factory" in kinds:
        words.append("--trust")
    return shlex.join(map(printable, words))
