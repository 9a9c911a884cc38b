"""Tables and sentences of a comparison and of a gate's result: each writer has the same ones."""

from collections.abc import Iterator, Sequence

from minitouch_bench.errors import printable
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.regression.comparison import (
    ComparedRun,
    Comparison,
    OutcomeChange,
    RunPair,
)
from minitouch_bench.regression.gate import NOT_ENOUGH_CODE, Decision, GateResult
from minitouch_bench.regression.paired_tests import Effect
from minitouch_bench.regression.pairing import COMPARED_METRICS
from minitouch_bench.reporting import tables
from minitouch_bench.reporting.formats import Block, Heading, NoteBlock
from minitouch_bench.reporting.labels import listed, task_title
from minitouch_bench.reporting.run_tables import OUTCOME_TITLES

SMALLEST_P = 0.0001
"""A p-value below is written as such: the bootstrap draws no finer ones."""

GATE_LABELS = ("Baseline", "Candidate", "Difference")

NOT_ALIKE = "The runs also differ beside the policies"


def comparison_tables(pair: RunPair) -> tuple[tables.Table, ...]:
    """Lay one run against the first, one table per metric: tasks down."""
    columns = tables.make_columns(
        pair.first, pair.second, f"{pair.second} minus {pair.first}", "p", "p adjusted", "Verdict",
        "Episodes to resolve", words=["Verdict"],
    )  # fmt: skip
    rows = []
    for compared in pair.metrics:
        effect, episodes = compared.effect, compared.episodes_to_resolve
        row = _row(
            effect,
            p_text(effect.p_value),
            p_text(compared.p_adjusted),
            compared.verdict,
            None if episodes is None else f"{episodes:,}",
        )
        rows.append((effect, row))
    return tuple(_by_metric(columns, rows))


def endpoint_table(result: GateResult) -> tables.Table:
    """Lay out what decides."""
    endpoint, effect = result.endpoint, result.endpoint.effect
    tolerance = result.settings.tolerance_of(effect.metric)
    allowed = tables.format_value(effect.metric, endpoint.tolerance)
    allowed = f"{allowed} ({tolerance})" if tolerance.relative else allowed
    row = _row(effect, allowed, p_text(endpoint.p_value), endpoint.decision.value)
    columns = tables.make_columns(*GATE_LABELS, "Tolerance", "p", "Decision", words=["Decision"])
    title = f"What decides: {effect_head(effect)}, over {listed(endpoint.tasks)}"
    return tables.Table(title, ("Task",), columns, (row,))


def task_tables(result: GateResult) -> tuple[tables.Table, ...]:
    """Lay out the metrics of each task, a table per metric: tasks down."""
    rows = []
    for metric in result.per_task:
        p_value, verdict = None, "not tested"
        if metric.p_adjusted is not None:
            p_value = p_text(metric.p_adjusted)
            verdict = "worse" if metric.is_worse else "not worse for certain"
        rows.append((metric.effect, _row(metric.effect, p_value, verdict)))
    columns = tables.make_columns(*GATE_LABELS, "p adjusted", "Verdict", words=["Verdict"])
    return tuple(_by_metric(columns, rows))


def _row(effect: Effect, *cells: str | None) -> tables.Row:
    values = (tables.format_value(effect.metric, value) for value in (effect.first, effect.second))
    return tables.make_row(task_title(effect.task), *values, difference_text(effect), *cells)


def _by_metric(
    columns: tuple[tables.Column, ...], rows: Sequence[tuple[Effect, tables.Row]]
) -> Iterator[tables.Table]:
    heads = {effect_head(effect): effect.metric for effect, _ in rows}
    for head in sorted(heads, key=lambda head: COMPARED_METRICS.index(heads[head])):
        of_head = tuple(row for effect, row in rows if effect_head(effect) == head)
        yield tables.Table(head, ("Task",), columns, of_head)


def changes_blocks(
    changes: Sequence[OutcomeChange], titles: tuple[str, str], most: int
) -> Iterator[Block]:
    """Lay out the episodes that ended in another way, with the command that replays each."""
    if not changes:
        return
    columns = (
        *tables.make_columns(*titles, words=titles),
        tables.Column(f"Replay of {titles[1]}", is_text=True, is_code=True),
    )
    rows = tuple(
        tables.make_row(
            change.episode,
            OUTCOME_TITLES[change.first],
            OUTCOME_TITLES[change.second],
            change.replays[1],
        )
        for change in changes[:most]
    )
    yield ""
    yield tables.Table("Episodes that ended in another way", ("Episode",), columns, rows)
    if (more := len(changes) - most) > 0:
        yield from ("", f"and {more} more; --json has all of them")


def difference_text(effect: Effect) -> str:
    """Write a difference with its sign and its 95 % interval."""
    return str(tables.difference_cell(effect.metric, effect.difference))


def p_text(p_value: float) -> str:
    """Write a p-value."""
    return f"<{SMALLEST_P:.4f}" if p_value < SMALLEST_P else f"{p_value:.4f}"


def effect_head(effect: Effect) -> str:
    """Name the metric of an effect with its better direction in the task, and its unit."""
    label = f"{METRICS[effect.metric].label} {effect.direction}".rstrip()
    return f"{label} ({effect.unit})"


def run_line(run: ComparedRun) -> str:
    """Say which run a title stands for, and what must be known of it."""
    labels = f" ({'; '.join(run.labels)})" if run.labels else ""
    return f"{run.title.capitalize()}: {run.name}, {printable(run.path)}{labels}"


def comparison_notes(comparison: Comparison) -> tuple[str, ...]:
    """Say how the figures of a comparison were made."""
    percent = f"{100 * comparison.alpha:g} %"
    paired = "; ".join(dict.fromkeys(METRICS[name].statistic.paired for name in COMPARED_METRICS))
    return (
        "Brackets and p: of this row alone. 95 % interval of the paired difference and its test: "
        f"{paired}; episode variance only. Where p is above 5 % the interval contains 0. "
        "It is too narrow for a mean of which few episodes differ or a few carry the difference.",
        "p adjusted and verdict: over all rows of the metric (its tasks and runs) by Holm's "
        f"method, judged at {percent}. Not clear once adjusted: the row alone would show a "
        "difference, among so many rows it may be chance.",
        "Mean: over the tasks with a goal, if they have equally many episodes. A metric without an "
        "arrow has no better direction.",
        "Episodes to resolve: for a power of 80 % at 5 %, if the difference is as observed.",
    )


def result_line(result: GateResult) -> str:
    """Say the gate's answer in one sentence that begins with the decision."""
    return f"{result.decision.value}: {_reason(result)}"


def _reason(result: GateResult) -> str:
    endpoint, effect = result.endpoint, result.endpoint.effect
    if result.identical:
        return "the run digests are equal, every episode is the same to the last bit"
    values = (tables.format_value(effect.metric, value) for value in (effect.first, effect.second))
    change = f"{effect.task} {effect.metric} {' → '.join(values)}"
    where = "beyond" if endpoint.is_beyond else "within"
    seen = f"{change} in {effect.count} episodes, {where} the tolerance"
    if endpoint.decision is Decision.REGRESSION:
        return f"{seen}, p {p_text(endpoint.p_value)}"
    if endpoint.decision is Decision.NO_REGRESSION:
        return f"{change}, a worsening beyond the tolerance is excluded"
    if endpoint.episodes_needed is None:
        most = f"even {MAX_EPISODES:,} episodes per task, the maximum, would not settle it"
        return f"{seen}; {most} if the difference is as observed"
    return f"{seen}; {endpoint.episodes_needed:,} episodes per task would settle it"


def gate_notes(result: GateResult) -> tuple[str, ...]:
    """Say how the figures of a result were made, and what is not alike."""
    notes = [f"{NOT_ALIKE}: {note}." for note in result.notes]
    alpha = f"{100 * result.settings.alpha:g} %"
    notes.append(
        "Brackets: 95 % interval of the paired difference, of the row alone. p: one-sided, that "
        f"the candidate is no worse. Chance of a false regression: at most {alpha}. Only after a "
        "regression are the metrics of each task tested, adjusted together by Holm's method."
    )
    notes.append(
        "regression: worse beyond the tolerance, and significant. no regression: the interval "
        "excludes a worsening beyond the tolerance. not enough episodes: neither; it fails "
        f"(exit {NOT_ENOUGH_CODE}) where the episodes seen are worse beyond the tolerance, with "
        "--strict always, with --lenient never."
    )
    return tuple(notes)


def comparison_blocks(comparison: Comparison, changes: int) -> Iterator[Block]:
    """Yield a whole comparison, with so many changed episodes of each pair."""
    yield from map(run_line, comparison.runs)
    for pair in comparison.pairs:
        yield Heading(f"{pair.second} against {pair.first}")
        if pair.identical:
            yield "The run digests are equal: every episode is the same to the last bit."
        yield from (f"{NOT_ALIKE}: {note}." for note in pair.notes)
        yield from comparison_tables(pair)
        yield from changes_blocks(pair.changes, (pair.first, pair.second), changes)
    yield ""
    yield from map(NoteBlock, comparison_notes(comparison))


def result_blocks(result: GateResult) -> Iterator[Block]:
    """Yield what a gate's answer rests on."""
    yield from map(run_line, (result.baseline, result.candidate))
    yield ""
    yield endpoint_table(result)
    yield from task_tables(result)
    yield ""
    yield from map(NoteBlock, gate_notes(result))
