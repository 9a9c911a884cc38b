"""Two methods compared by a run of each of their training seeds, and shown; the seed is the unit.

Two-sided, where the gate of ``retrainings`` is one-sided: the same differences and intervals.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

from minitouch_bench.comparison import effect_tables, gate_report, pairing
from minitouch_bench.comparison.comparison import effect_in_words, shared_tasks
from minitouch_bench.comparison.gate import TrainingValue
from minitouch_bench.comparison.pairing import MEAN_TASK, ComparedRun, Effect
from minitouch_bench.comparison.retrainings import (
    compare_trainings,
    pair_trainings,
    side_of,
    training_differences,
)
from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.statistics import (
    ALPHA,
    ALPHA_IN_WORDS,
    FEWEST_FOR_A_MEAN,
    MAX_SEEDS,
    POWER,
    holm,
    seeds_to_decide,
)
from minitouch_bench.reporting import tables
from minitouch_bench.reporting.labels import format_value, tasks_in_order
from minitouch_bench.runs.run import Run
from minitouch_bench.text import printable

SIDES = ("A", "B")

LARGE = 0.1
"""A difference of a share that a study of methods is planned for."""

METHODS_VERSION = 1
"""Of the JSON document."""


@dataclass(frozen=True)
class MethodMetric:
    """One metric of one task in the trainings of both methods.

    ``p_adjusted`` is over the rows of the metric. Training seeds of each method: ``to_decide``
    would show the difference if it is as observed, None where it is shown or too many are needed;
    ``to_find`` show a difference of LARGE in POWER of such studies, None for no share.
    """

    effect: Effect
    p_adjusted: float
    verdict: str
    to_decide: int | None
    to_find: int | None


@dataclass(frozen=True, repr=False)
class MethodComparison:
    """Two methods, each by its trainings; ``main`` is what sums them up, one of ``metrics``."""

    methods: tuple[ComparedRun, ComparedRun]
    trainings: tuple[TrainingValue, ...]
    main: MethodMetric
    metrics: tuple[MethodMetric, ...]
    notes: tuple[str, ...]
    alpha: float = ALPHA

    def __repr__(self) -> str:
        return f"<MethodComparison: {answer_line(self)}>"

    def __str__(self) -> str:
        return tables.as_text(method_blocks(self))

    def _repr_markdown_(self) -> str:
        return "\n".join(tables.as_markdown(method_blocks(self)))


def compare_method_runs(
    sides: tuple[Sequence[Run], Sequence[Run]], paths: Sequence[Sequence[str]]
) -> MethodComparison:
    """Compare two methods by the runs of their training seeds; ``paths``: their directories.

    Raises:
        UsageError: a method has one run, one training twice or runs under several conditions; the
            runs have too few episodes, or not the same ones.
    """
    for title, side in zip(SIDES, sides, strict=True):
        if len(side) < 2:
            raise UsageError(
                f"a method is compared by two training seeds or more, and --{title.lower()} names "
                f"{len(side)}: for two runs give their directories alone"
            )
        if len({run.plan.conditions for run in side}) > 1:
            raise UsageError(f"the runs of {title} are not of one method: their conditions differ")
    runs = [*sides[0], *sides[1]]
    kept = shared_tasks(runs)
    pairs = pair_trainings((kept[: len(sides[0])], kept[len(sides[0]) :]), SIDES)
    tasks = tasks_in_order(kept[:1])
    rows = [pairing.collect_values(one, tasks) for side in pairs for one in side]
    per_metric = [
        (both[: len(sides[0])], both[len(sides[0]) :]) for both in zip(*rows, strict=True)
    ]
    if (episodes := min(len(one.first) for one in rows[0])) < FEWEST_FOR_A_MEAN:
        raise UsageError(
            f"methods are compared by {FEWEST_FOR_A_MEAN} episodes of each task or more, not by "
            f"{episodes}: evaluate all runs again with more"
        )
    metrics = tuple(_judge(per_metric))
    main = next(
        (one for one in metrics if one.effect.task == MEAN_TASK),
        next(one for one in metrics if one.effect.metric == ranking_metric(one.effect.task)),
    )
    of_main = per_metric[metrics.index(main)]
    trainings = tuple(
        TrainingValue(title, path, float(values.second.mean()))
        for title, side, places in zip(SIDES, of_main, paths, strict=True)
        for values, path in zip(side, places, strict=True)
    )
    first, second = map(side_of, SIDES, sides, paths)
    left_out = sorted({task for run in runs for task in run.tasks} - {*tasks})
    lacking = [f"left out, because not every run has it: {task}" for task in left_out]
    notes = (*map(printable, lacking), *pairing.exploration_left_out(runs))
    return MethodComparison((first, second), trainings, main, metrics, notes)


def _judge(
    per_metric: Sequence[tuple[Sequence[pairing.PairedValues], ...]],
) -> Iterator[MethodMetric]:
    """Yield what each metric of each task shows, adjusted over the rows of its metric."""
    effects = [compare_trainings(sides) for sides in per_metric]
    adjusted = {
        metric: holm([one.p_value for one in effects if one.metric == metric])
        for metric in pairing.COMPARED_METRICS
    }
    rest = {metric: iter(p_values) for metric, p_values in adjusted.items()}
    for sides, effect in zip(per_metric, effects, strict=True):
        p_adjusted = next(rest[effect.metric])
        undecided = sum(p > ALPHA for p in adjusted[effect.metric])
        found, seeds = training_differences(sides), (len(sides[1]), len(sides[0]))
        yield MethodMetric(
            effect,
            p_adjusted,
            effect_in_words(effect, p_adjusted, SIDES),
            seeds_to_decide(found, seeds, ALPHA / undecided) if p_adjusted > ALPHA else None,
            seeds_to_decide(found, seeds, ALPHA, LARGE)
            if METRICS[effect.metric].is_fraction
            else None,
        )


def answer_line(comparison: MethodComparison) -> str:
    """Say in one sentence what was found, and how many seeds would say more."""
    main = comparison.main
    effect = main.effect
    values = (format_value(effect.metric, one) for one in (effect.first, effect.second))
    in_both = ", ".join(map(" ".join, zip(SIDES, values, strict=True)))
    answer = f"{main.verdict}: {effect.task} {effect.metric} {in_both}"
    if main.p_adjusted > ALPHA and main.effect.differing:
        number = gate_report.seeds_in_words(main.to_decide, comparison.trainings)
        answer += f"; {number} would decide if the difference is as observed"
    if main.to_find:
        answer += (
            f". A difference of {LARGE:g} is found in {100 * POWER:g} % of such studies by "
            f"{main.to_find} training seeds on each side"
        )
    return answer


def method_blocks(comparison: MethodComparison) -> Iterator[tables.Block]:
    """Yield a whole comparison of methods; the last line is the answer."""
    yield from map(effect_tables.run_line, comparison.methods)
    yield from (f"{note}." for note in comparison.notes)
    yield ""
    yield gate_report.trainings_table(comparison.trainings, comparison.main.effect)
    columns = tables.make_columns(
        *SIDES, "B minus A", "p", "p adjusted", "Verdict", "Seeds to decide",
        f"Seeds for {LARGE:g}", words=["Verdict"],
    )  # fmt: skip
    rows = [
        (
            one.effect,
            effect_tables.p_text(one.effect.p_value),
            effect_tables.p_text(one.p_adjusted),
            one.verdict,
            f"{one.to_decide:,}" if one.to_decide else None,
            f"{one.to_find:,}" if one.to_find else None,
        )
        for one in comparison.metrics
    ]
    yield from effect_tables.tables_by_metric(columns, rows)
    yield ""
    yield from map(tables.NoteBlock, _notes())
    yield from ("", answer_line(comparison))


def _notes() -> tuple[str, ...]:
    return (
        "Brackets and p: of this row alone, two-sided; 95 % interval and Student's t over training "
        "seeds, on the same episodes. p adjusted and verdict: over all rows of the metric by "
        f"Holm's method, judged at {ALPHA_IN_WORDS}. Where some seeds fail to learn, no test over "
        "a few seeds keeps its level: look at each seed's value.",
        "Seeds to decide: about how many training seeds of each method, those present included, "
        f"find the difference in {100 * POWER:g} % of such studies if it is as observed. Seeds for "
        f"{LARGE:g}: the same for a difference of {LARGE:g}, in this row alone. Both rest on the "
        f"seeds' spread as observed. A dash: shown already, or more than {MAX_SEEDS:,}, where only "
        "more episodes help.",
    )


def methods_markdown(comparison: MethodComparison) -> str:
    """Write a comparison of methods as a page."""
    lines = tables.as_markdown(method_blocks(comparison))
    return "\n".join(["# Comparison of methods", "", *lines]) + "\n"


def methods_json(comparison: MethodComparison) -> str:
    """Write a comparison of methods; the keys are the fields of ``MethodComparison``."""
    mark = {"format": "minitouch-methods", "version": METHODS_VERSION}
    return effect_tables.json_text({**mark, **asdict(comparison)})
