"""Runs of the same episodes compared, each against the first, and shown."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from rich.console import Console

from minitouch_bench.comparison import effect_tables, pairing
from minitouch_bench.comparison.pairing import ComparedRun, Effect, OutcomeChange
from minitouch_bench.errors import UsageError
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.metrics.definitions import METRICS, NO_DIRECTION
from minitouch_bench.metrics.statistics import ALPHA, ALPHA_IN_WORDS, POWER, holm
from minitouch_bench.reporting import tables
from minitouch_bench.reporting.labels import run_labels, run_names, tasks_in_order
from minitouch_bench.runs.run import Run
from minitouch_bench.text import printable

if TYPE_CHECKING:
    import pandas as pd

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"

COMPARISON_VERSION = 4
"""Of the JSON document."""


@dataclass(frozen=True)
class ComparedMetric:
    """One metric of one task in two runs, and what it shows.

    ``p_adjusted`` is over the tasks and runs of the metric. ``episodes_to_resolve``, of each
    task, would show the difference if it is as observed; None for no difference or too many.
    """

    effect: Effect
    p_adjusted: float
    verdict: str
    episodes_to_resolve: int | None


@dataclass(frozen=True)
class RunPair:
    """One run against the first, by their titles. ``notes``: what else is not alike."""

    first: str
    second: str
    identical: bool
    metrics: tuple[ComparedMetric, ...]
    changes: tuple[OutcomeChange, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, repr=False)
class Comparison:
    """All runs against the first; ``alpha``: chance of a false difference in a metric."""

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

    def __str__(self) -> str:
        return tables.as_text(comparison_blocks(self, effect_tables.SHOWN_CHANGES))

    def _repr_markdown_(self) -> str:
        return "\n".join(tables.as_markdown(comparison_blocks(self, effect_tables.SHOWN_CHANGES)))


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
    shared = [pairing.share_roles(shared_tasks((runs[0], other))) for other in runs[1:]]
    paired = [pairing.pair_runs(*both) for both in shared]
    tasks, root = tasks_in_order(runs), (runs[0].plan.seed,)
    tested = [
        [
            (values, pairing.paired_test(values, root))
            for values in pairing.collect_values(pairs, tasks)
        ]
        for pairs in paired
    ]
    adjusted = _adjusted([effect for row in tested for _, effect in row])
    first = named[0]
    return Comparison(
        tuple(named),
        tuple(
            RunPair(
                first=first.title,
                second=other.title,
                identical=pairing.are_identical(both[0], both[1], pairs),
                metrics=tuple(
                    ComparedMetric(
                        effect,
                        p_adjusted := next(adjusted),
                        effect_in_words(effect, p_adjusted, (first.title, other.title)),
                        pairing.episodes_needed(values, ALPHA),
                    )
                    for values, effect in row
                ),
                changes=pairing.find_changes(pairs, (runs[0], run), (first.path, other.path)),
                notes=tuple(pairing.differences_of_making(runs[0], run)),
            )
            for other, run, both, pairs, row in zip(
                named[1:], runs[1:], shared, paired, tested, strict=True
            )
        ),
    )


def shared_tasks(runs: Sequence[Run]) -> list[Run]:
    """Return runs without the tasks that not all of them have.

    Raises:
        UsageError: they have no task in common.
    """
    tasks = [task for task in runs[0].tasks if all(task in run.tasks for run in runs)]
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


def paired_with_first(runs: Sequence[Run]) -> list[pairing.Pairs]:
    """Return the pairs of episodes of each run and the first."""
    shared = (pairing.share_roles(shared_tasks((runs[0], other))) for other in runs[1:])
    return [pairing.pair_runs(*both) for both in shared]


def _adjusted(effects: Sequence[Effect]) -> Iterator[float]:
    """Yield each effect's p-value, adjusted over all effects of its metric."""
    adjusted = {
        metric: iter(holm([effect.p_value for effect in effects if effect.metric == metric]))
        for metric in pairing.COMPARED_METRICS
    }
    return (next(adjusted[effect.metric]) for effect in effects)


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


def comparison_blocks(comparison: Comparison, changes: int) -> Iterator[tables.Block]:
    """Yield a whole comparison, with so many changed episodes of each pair."""
    yield from map(effect_tables.run_line, comparison.runs)
    for pair in comparison.pairs:
        yield tables.Heading(f"{pair.second} against {pair.first}")
        if pair.identical:
            yield "The run digests are equal: every episode is the same to the last bit."
        yield from (f"{effect_tables.NOT_ALIKE}: {note}." for note in pair.notes)
        yield from comparison_tables(pair)
        yield from effect_tables.changes_blocks(pair.changes, (pair.first, pair.second), changes)
    yield ""
    yield from map(tables.NoteBlock, comparison_notes())


def comparison_tables(pair: RunPair) -> tuple[tables.Table, ...]:
    """Lay one run against the first, one table per metric: tasks down."""
    columns = tables.make_columns(
        pair.first, pair.second, f"{pair.second} minus {pair.first}", "p", "p adjusted", "Verdict",
        "Episodes to resolve", words=["Verdict"],
    )  # fmt: skip
    cells = [
        (
            compared.effect,
            effect_tables.p_text(compared.effect.p_value),
            effect_tables.p_text(compared.p_adjusted),
            compared.verdict,
            f"{compared.episodes_to_resolve:,}" if compared.episodes_to_resolve else None,
        )
        for compared in pair.metrics
    ]
    return tuple(effect_tables.tables_by_metric(columns, cells))


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


def show_comparison(comparison: Comparison, console: Console) -> None:
    """Print a comparison."""
    tables.show(comparison_blocks(comparison, effect_tables.SHOWN_CHANGES), console)


def comparison_markdown(comparison: Comparison) -> str:
    """Write a comparison as a page, with every changed episode."""
    lines = tables.as_markdown(comparison_blocks(comparison, MAX_EPISODES))
    return "\n".join(["# Comparison of runs", "", *lines]) + "\n"


def comparison_json(comparison: Comparison) -> str:
    """Write a comparison; the keys are the fields of ``Comparison``."""
    return effect_tables.json_text(
        {"format": "minitouch-comparison", "version": COMPARISON_VERSION, **asdict(comparison)}
    )
