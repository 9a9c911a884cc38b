"""Runs of the same episodes compared, each against the first, and shown.

The tables of effects and of changed episodes are those of methods and of ``regress`` too.
"""

import json
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from rich.console import Console

from minitouch_bench.comparison import pairing
from minitouch_bench.comparison.pairing import ComparedRun, Effect, OutcomeChange
from minitouch_bench.episode import Role, role_of
from minitouch_bench.errors import UsageError
from minitouch_bench.files import MAX_EPISODES, write_file
from minitouch_bench.metrics.definitions import METRICS, NO_DIRECTION
from minitouch_bench.metrics.statistics import ALPHA, ALPHA_IN_WORDS, POWER, holm
from minitouch_bench.reporting import pages, tables
from minitouch_bench.reporting.labels import (
    difference_cell,
    format_value,
    metric_head,
    run_labels,
    run_names,
    task_title,
    tasks_in_order,
)
from minitouch_bench.reporting.maps import change_figure
from minitouch_bench.reporting.report_tables import OUTCOME_TITLES
from minitouch_bench.runs.run import Run
from minitouch_bench.text import printable

if TYPE_CHECKING:
    import pandas as pd

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"

COMPARISON_VERSION = 5
"""Of the JSON document."""

SMALLEST_P = 0.0001
"""A smaller p-value is written as "less than this one": the bootstrap is no finer."""

NOT_ALIKE = "Not alike"

SHOWN_CHANGES, LISTED_CHANGES = 20, 10
"""Changed episodes that a screen, and that a page lists; the JSON has all of them."""


@dataclass(frozen=True)
class MetricVerdict:
    """What a metric of a task shows: ``p_adjusted`` is over all rows of the metric.

    ``needed``: episodes of each task, or training seeds of each method, that would show the
    difference if it is as observed; None for no difference or too many, and where the training
    seeds present have shown it.
    """

    effect: Effect
    p_adjusted: float
    verdict: str
    needed: int | None


@dataclass(frozen=True)
class RunPair:
    """One run against the first, by their titles. ``notes``: what else is not alike."""

    first: str
    second: str
    identical: bool
    metrics: tuple[MetricVerdict, ...]
    changes: tuple[OutcomeChange, ...]
    notes: tuple[str, ...]

    @property
    def titles(self) -> tuple[str, str]:
        """The titles of both runs."""
        return self.first, self.second


class WrittenComparison(ABC):
    """Base of comparisons: dataclasses that are shown as blocks of text and tables."""

    heading: ClassVar[str]
    mark: ClassVar[Mapping[str, str | int]]
    """The first keys of the JSON document."""

    @abstractmethod
    def _blocks(self, changes: int) -> Iterator[tables.Block]:
        """Yield the whole comparison, with so many changed episodes of each pair."""

    def __str__(self) -> str:
        return tables.as_text(self._blocks(SHOWN_CHANGES))

    def _repr_markdown_(self) -> str:
        return "\n".join(tables.as_markdown(self._blocks(SHOWN_CHANGES)))

    def show(self, console: Console) -> None:
        """Print the comparison as wide as the console is."""
        tables.show(self._blocks(SHOWN_CHANGES), console)

    def to_json(self) -> str:
        """Return the comparison as JSON; the keys are its fields."""
        return json_text({**self.mark, **asdict(self)})  # type: ignore[call-overload]

    def write(self, folder: Path) -> None:
        """Write comparison.json, and comparison.md with every changed episode."""
        write_file(folder / "comparison.json", self.to_json())
        page = [f"# {self.heading}", "", *tables.as_markdown(self._blocks(MAX_EPISODES))]
        write_file(folder / "comparison.md", "\n".join(page) + "\n")


@dataclass(frozen=True, repr=False)
class Comparison(WrittenComparison):
    """All runs against the first; ``alpha``: chance of a false difference in a metric."""

    heading = "Comparison of runs"
    mark = MappingProxyType({"format": "minitouch-comparison", "version": COMPARISON_VERSION})

    runs: tuple[ComparedRun, ...]
    pairs: tuple[RunPair, ...]
    alpha: float = ALPHA

    def to_frame(self) -> "pd.DataFrame":
        """Return a row per pair of runs (their letters), metric and task, as the tables have it."""
        import pandas as pd  # noqa: PLC0415  takes half a second

        return pd.DataFrame(
            {
                "first": pair.first, "second": pair.second,
                "task": effect.task, "metric": effect.metric, "unit": effect.unit,
                "first_value": effect.first, "second_value": effect.second,
                "difference": effect.difference.value,
                "low": effect.difference.low, "high": effect.difference.high,
                "count": effect.difference.count, "p_value": effect.p_value,
                **{name: value for name, value in vars(compared).items() if name != "effect"},
            }
            for pair in self.pairs
            for compared in pair.metrics
            for effect in (compared.effect,)
        )  # fmt: skip

    def __repr__(self) -> str:
        names = ", ".join(f"{run.title} {run.name}" for run in self.runs)
        changed = sum(len(pair.changes) for pair in self.pairs)
        return f"<Comparison of {names}: {changed} changed outcomes>"

    def _blocks(self, changes: int) -> Iterator[tables.Block]:
        yield from map(run_line, self.runs)
        for pair in self.pairs:
            yield tables.Heading(f"{pair.second} against {pair.first}")
            if pair.identical:
                yield "The run digests are equal: every episode is the same to the last bit."
            yield from (f"{NOT_ALIKE}: {note}." for note in pair.notes)
            yield from _metric_tables(pair)
            yield from changes_blocks(pair.changes, pair.titles, changes)
        yield ""
        yield from map(tables.NoteBlock, comparison_notes())


def compare_runs(runs: Sequence[Run], paths: Sequence[str]) -> Comparison:
    """Compare each run with the first; ``paths`` are their directories, for replaying.

    Raises:
        UsageError: fewer than two runs or more than LETTERS, or runs whose common tasks were not
            made of the same episodes by the same protocol.
    """
    if not 2 <= len(runs) <= len(LETTERS):
        raise UsageError(f"compare takes 2 to {len(LETTERS)} runs, not {len(runs)}")
    named = [
        ComparedRun(letter, name, path, run_labels(run))
        for letter, name, path, run in zip(LETTERS, run_names(runs), paths, runs, strict=False)
    ]
    paired = [*_beside_first(runs)]
    tasks, root = tasks_in_order(runs), (runs[0].plan.seed,)
    values = [pairing.collect_values(pairs, tasks) for _, pairs in paired]
    effects = [[pairing.paired_test(one, root) for one in of_pair] for of_pair in values]
    adjusted = iter(adjust([*chain(*effects)]))
    compared = []
    for number, (shared, pairs) in enumerate(paired):
        first, other, run = named[0], named[number + 1], runs[number + 1]
        metrics = []
        for of_metric, effect in zip(values[number], effects[number], strict=True):
            p_adjusted = next(adjusted)
            verdict = effect_in_words(effect, p_adjusted, (first.title, other.title))
            episodes = pairing.episodes_needed(of_metric, ALPHA)
            metrics.append(MetricVerdict(effect, p_adjusted, verdict, episodes))
        compared.append(
            RunPair(
                first=first.title,
                second=other.title,
                identical=shared[0].digest == shared[1].digest
                and not any(effect.differing for effect in effects[number]),
                metrics=tuple(metrics),
                changes=pairing.find_changes(pairs, (runs[0], run), (first.path, other.path)),
                notes=tuple(pairing.differences_of_making(runs[0], run)),
            )
        )
    return Comparison(tuple(named), tuple(compared))


def _beside_first(runs: Sequence[Run]) -> Iterator[tuple[tuple[Run, ...], pairing.Pairs]]:
    """Yield the first and each other run, without what one of them lacks, and their pairs."""
    for other in runs[1:]:
        shared = pairing.share_roles(shared_tasks((runs[0], other)))
        yield shared, pairing.pair_runs(*shared)


def shared_tasks(runs: Sequence[Run]) -> list[Run]:
    """Return runs without the tasks that not all of them have, or not by the first one's rules.

    A run whose tasks are all by other rules keeps them: pairing refuses it by name.

    Raises:
        UsageError: they have no task in common.
    """
    tasks = [task for task in runs[0].tasks if all(task in run.tasks for run in runs)]
    differ = {task for run in runs for task in runs[0].header.rules_differ(run.header)}
    tasks = [task for task in tasks if task not in differ] or tasks
    if not tasks:
        of_each = " and ".join(f"'{run.place}' of {', '.join(run.tasks)}" for run in runs)
        raise UsageError(f"no task to compare: {printable(of_each)}")
    shared = []
    for run in runs:
        rows, exploration = (
            tuple(row for row in part if row.task in tasks)
            for part in (run.rows, run.exploration_rows)
        )
        shared.append(replace(run, rows=rows, exploration_rows=exploration))
    return shared


def adjust(effects: Sequence[Effect]) -> list[float]:
    """Return each effect's p-value, adjusted over all effects of its metric."""
    adjusted = {
        metric: iter(holm([effect.p_value for effect in effects if effect.metric == metric]))
        for metric in pairing.COMPARED_METRICS
    }
    return [next(adjusted[effect.metric]) for effect in effects]


def effect_in_words(effect: Effect, p_adjusted: float, titles: tuple[str, str]) -> str:
    """Put an effect into words: without a better direction the second run has more or less."""
    if effect.differing == 0:
        return "equal in every episode"
    if not effect.is_clear:
        return "no difference seen"
    if p_adjusted > ALPHA:
        return "not clear once adjusted"
    if effect.direction == NO_DIRECTION:
        return f"{titles[1]} has {'more' if effect.difference.value > 0 else 'less'}"
    return f"{titles[0] if effect.worsening > 0 else titles[1]} is better"


# What is written


def _metric_tables(pair: RunPair) -> tuple[tables.Table, ...]:
    return verdict_tables(pair.titles, pair.metrics, "Episodes to resolve")


def comparison_notes() -> tuple[str, ...]:
    """Say how the figures of a comparison were made."""
    paired = "; ".join(
        dict.fromkeys(METRICS[name].statistic.paired for name in pairing.COMPARED_METRICS)
    )
    return (
        "Brackets and p: of this row alone. 95 % interval of the paired difference and its test: "
        f"{paired}; episode variance only. Where p is above {ALPHA_IN_WORDS} the interval "
        "contains 0. It is too narrow for a mean of which few episodes differ or a few carry the "
        "difference.",
        "p adjusted and verdict: over all rows of the metric (its tasks and runs) by Holm's "
        f"method, judged at {ALPHA_IN_WORDS}. Not clear once adjusted: the row alone would show a "
        "difference, among so many rows it may be chance.",
        "Mean: over the tasks with a goal, if they have equally many episodes. A metric without an "
        "arrow has no better direction.",
        "Episodes to resolve: about how many episodes of each task find the difference in "
        f"{100 * POWER:g} % of cases, at {ALPHA_IN_WORDS}, if it is as observed.",
    )


def comparison_html(comparison: Comparison, runs: Sequence[Run]) -> str:
    """Write a comparison of these runs as a page that opens offline: tables, maps, commands."""
    views = []
    for pair, (_, pairs) in zip(comparison.pairs, _beside_first(runs), strict=True):
        final = [both for key, both in pairs.items() if role_of(key) is Role.FINAL]
        found = {
            task: [both for both in final if both[0].task == task] for task in tasks_in_order(runs)
        }
        by_task = {task: both for task, both in found.items() if both}
        changes = [changes_table(pair.changes, pair.titles, LISTED_CHANGES)]
        views.append(
            {
                "pair": pair,
                "figure": change_figure(f"maps-{pair.second}", by_task, pair.titles),
                "metrics": _metric_tables(pair),
                "changes": changes if pair.changes else [],
            }
        )
    return pages.render_page(
        pages.TEMPLATES / "comparison.html.j2",
        scripts=("theme.js",),
        comparison=comparison,
        views=views,
        not_alike=NOT_ALIKE,
        notes=comparison_notes(),
    )


# The parts that methods and ``regress`` show too


def effect_row(effect: Effect, *cells: str | None) -> tables.Row:
    """Lay out a task's values in both runs, their difference, and more cells."""
    values = (format_value(effect.metric, value) for value in (effect.first, effect.second))
    difference = difference_cell(effect.metric, effect.difference)
    return tables.make_row(task_title(effect.task), *values, difference, *cells)


def tables_by_metric(
    columns: tuple[tables.Column, ...], rows: Sequence[tuple[Effect, Sequence[str | None]]]
) -> Iterator[tables.Table]:
    """Yield a table for each metric, in the metrics' order, from effects and more cells."""
    heads = {effect_head(effect): effect.metric for effect, _ in rows}
    for head in sorted(heads, key=lambda head: pairing.COMPARED_METRICS.index(heads[head])):
        of_head = tuple(effect_row(one, *cells) for one, cells in rows if effect_head(one) == head)
        yield tables.Table(head, ("Task",), columns, of_head)


def verdict_tables(
    titles: tuple[str, str], found: Sequence[MetricVerdict], label: str
) -> tuple[tables.Table, ...]:
    """Lay out verdicts, one table per metric: tasks down; ``label`` heads the last column."""
    first, second = titles
    columns = tables.make_columns(
        first, second, f"{second} minus {first}", "p", "p adjusted", "Verdict", label,
        words=["Verdict"],
    )  # fmt: skip
    rows = []
    for one in found:
        number = f"{one.needed:,}" if one.needed else None
        cells = p_text(one.effect.p_value), p_text(one.p_adjusted), one.verdict, number
        rows.append((one.effect, cells))
    return tuple(tables_by_metric(columns, rows))


def changes_table(
    changes: Sequence[OutcomeChange], titles: tuple[str, str], most: int
) -> tables.Table:
    """Lay out the episodes that ended in another way, with the command that replays each."""
    columns = (
        *tables.make_columns(*titles, words=titles),
        tables.Column("Replay", is_text=True, is_code=True),
    )
    rows = tuple(
        tables.make_row(
            one.episode, OUTCOME_TITLES[one.first], OUTCOME_TITLES[one.second], one.replay
        )
        for one in changes[:most]
    )
    return tables.Table("Episodes that ended in another way", ("Episode",), columns, rows)


def changes_blocks(
    changes: Sequence[OutcomeChange], titles: tuple[str, str], most: int
) -> Iterator[tables.Block]:
    """Yield the table of changed episodes, if there are some, and how many more there are."""
    if changes:
        yield from ("", changes_table(changes, titles, most))
    if (more := len(changes) - most) > 0:
        yield from ("", f"and {more} more; --json has all of them")


def p_text(p_value: float) -> str:
    """Write a p-value."""
    return f"<{SMALLEST_P:.4f}" if p_value < SMALLEST_P else f"{p_value:.4f}"


def effect_head(effect: Effect) -> str:
    """Name the metric of an effect with its better direction in the task, and its unit."""
    return f"{metric_head(effect.metric, effect.task)} ({effect.unit})"


def run_line(run: ComparedRun) -> str:
    """Name the run that has a title, with its labels."""
    labels = f" ({'; '.join(run.labels)})" if run.labels else ""
    return f"{run.title.capitalize()}: {run.name}, {printable(run.path)}{labels}"


def json_text(document: dict[str, Any]) -> str:
    """Write a JSON document; NaN and infinity are refused."""
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
