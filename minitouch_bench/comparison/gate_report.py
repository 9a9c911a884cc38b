"""What the result of ``regress`` looks like: tables, JSON, Markdown and JUnit."""

from collections.abc import Iterator
from dataclasses import asdict
from xml.etree import ElementTree

from rich.console import Console
from rich.text import Text

from minitouch_bench.comparison.comparison import (
    NOT_ALIKE,
    SHOWN_CHANGES,
    changes_blocks,
    effect_head,
    effect_row,
    json_text,
    p_text,
    run_line,
    tables_by_metric,
)
from minitouch_bench.comparison.gate import GATE_SIDES, Decision, GateResult
from minitouch_bench.comparison.pairing import Effect
from minitouch_bench.comparison.training_seeds import seeds_in_words, trainings_table
from minitouch_bench.errors import IncompleteCheckError
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.reporting import tables
from minitouch_bench.reporting.labels import counted, difference_cell, format_value, listed
from minitouch_bench.text import numbered, printable

SUMMARY_CHANGES = 50
"""Changed episodes that a result's page lists; the JSON has all of them."""

GATE_LABELS = ("Baseline", "Candidate", "Difference")

DECISION_STYLES = {Decision.NO_REGRESSION: "bold green", Decision.REGRESSION: "bold red"}
MARKS = {Decision.NO_REGRESSION: "✅", Decision.REGRESSION: "❌"}
OPEN_STYLE, OPEN_MARK = "bold yellow", "❔"

RESULT_VERSION = 7
"""Of the JSON document."""

SUITE = "minitouch-bench regress"


def show_result(result: GateResult, console: Console) -> None:
    """Print a gate's result; the last two lines are the answer, and what to type next."""
    changes = changes_blocks(result.changes, GATE_SIDES, SHOWN_CHANGES)
    tables.show((*result_blocks(result), *changes, ""), console)
    style = DECISION_STYLES.get(result.decision, OPEN_STYLE)
    console.print(Text(result_line(result), style=style), soft_wrap=True)
    console.print(Text(f"next: {result.next_command}"), soft_wrap=True)


def gate_markdown(result: GateResult) -> str:
    """Write a result as a section of a page, such as a GitHub step summary."""
    answer = tables.escape_md(result_line(result))
    lines = [f"## {MARKS.get(result.decision, OPEN_MARK)} minitouch-bench {answer}", ""]
    lines += [f"- next: {tables.code_span(result.next_command)}"]
    lines += tables.as_markdown(result_blocks(result))
    if result.changes:
        title = f"{numbered(len(result.changes), 'episode')} ended in another way"
        lines += ["", f"<details><summary>{title}</summary>"]
        lines += tables.as_markdown(changes_blocks(result.changes, GATE_SIDES, SUMMARY_CHANGES))
        lines += ["", "</details>"]
    return "\n".join(lines) + "\n"


def gate_json(result: GateResult) -> str:
    """Write a gate's result; the keys are the fields of ``GateResult``."""
    mark = {"format": "minitouch-regression", "version": RESULT_VERSION}
    return json_text({**mark, "exit_code": result.exit_code, **asdict(result)})


def gate_junit(result: GateResult) -> str:
    """Write a result as a JUnit report: the gate's own test case, and one per metric of a task.

    The names of the cases depend on the baseline's suite, tasks and metrics alone, not on the
    outcome.
    Not enough episodes are a failure where the gate fails, otherwise skipped. A metric of a task is
    skipped unless there is a regression, after which alone it is tested. Source of the form: the
    Ant task "JUnitReport", as CI servers read it.
    """
    answer, endpoint = result_line(result), result.endpoint
    within = "" if result.suite == MAIN_SUITE else f"{result.suite}."
    cases = [_case(f"{within}gate", endpoint.effect, _kind(result), answer, endpoint.p_value)]
    cases[0].set("name", f"{endpoint.effect.task} {endpoint.effect.metric}")
    cases[0].set("time", f"{result.wall_s:.3f}")
    for metric in result.per_task:
        kind, words = "failure" if metric.is_worse else "system-out", "worse"
        if metric.p_adjusted is None:
            kind, words = "skipped", "tested only after a regression"
        group = f"{within}{metric.effect.task}"
        cases.append(_case(group, metric.effect, kind, words, metric.p_adjusted))
    counts = {
        "tests": str(len(cases)),
        "failures": str(sum(case.find("failure") is not None for case in cases)),
        "errors": "0",
        "skipped": str(sum(case.find("skipped") is not None for case in cases)),
        "time": f"{result.wall_s:.3f}",
    }
    root = ElementTree.Element("testsuites", {"name": SUITE, **counts})
    suite = ElementTree.SubElement(root, "testsuite", {"name": SUITE, **counts})
    suite.extend(cases)
    lines = [*gate_notes(result), f"next: {result.next_command}"]
    ElementTree.SubElement(suite, "system-out").text = "\n".join(map(printable, lines))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _kind(result: GateResult) -> str:
    """Return the element that says how the gate ended; a passed one has its output only."""
    if result.exit_code:
        return "failure"
    return "skipped" if result.decision.is_open else "system-out"


def _case(
    group: str, effect: Effect, kind: str, words: str, p_value: float | None
) -> ElementTree.Element:
    """Return a test case, with an element ``kind`` that says how it ended."""
    difference = difference_cell(effect.metric, effect.difference)
    case = ElementTree.Element(
        "testcase", {"classname": f"minitouch.{group}", "name": effect.metric}
    )
    element = ElementTree.SubElement(case, kind)
    if kind != "system-out":
        element.set("message", printable(f"{words}: {difference}"))
    if kind == "failure":
        element.set("type", printable(words.partition(":")[0]))
    tested = "not tested" if p_value is None else f"p {p_text(p_value)}"
    element.text = printable(
        f"{effect_head(effect)}: candidate minus baseline {difference}, {tested}, "
        f"{counted(effect.difference)}"
    )
    return case


def endpoint_table(result: GateResult) -> tables.Table:
    """Lay out what decides."""
    endpoint, effect = result.endpoint, result.endpoint.effect
    tolerance = result.settings.tolerance_of(effect.metric)
    allowed = format_value(effect.metric, endpoint.tolerance)
    allowed = f"{allowed} ({tolerance})" if tolerance.relative else allowed
    row = effect_row(effect, allowed, p_text(endpoint.p_value), endpoint.decision.value)
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
            verdict = "worse" if metric.is_worse else "not significant alone"
        rows.append((metric.effect, (p_value, verdict)))
    columns = tables.make_columns(*GATE_LABELS, "p adjusted", "Verdict", words=["Verdict"])
    return tuple(tables_by_metric(columns, rows))


def result_line(result: GateResult) -> str:
    """Say the gate's answer in one sentence that begins with the decision."""
    return f"{result.decision.value}: {_reason(result)}"


def _reason(result: GateResult) -> str:
    endpoint, effect = result.endpoint, result.endpoint.effect
    if result.identical:
        return "the run digests are equal, every episode is the same to the last bit"
    values = (format_value(effect.metric, value) for value in (effect.first, effect.second))
    change = f"{effect.task} {effect.metric} {' → '.join(values)}"
    where = "beyond" if endpoint.is_beyond else "within"
    seen = f"{change} in {counted(effect.difference)}, {where} the tolerance"
    if endpoint.decision is Decision.REGRESSION:
        return f"{seen}, p {p_text(endpoint.p_value)}"
    if endpoint.decision is Decision.NO_REGRESSION:
        return f"{change}, a worsening beyond the tolerance is excluded"
    if endpoint.decision is Decision.NOT_ENOUGH_SEEDS:
        return f"{seen}; {seeds_in_words(endpoint.seeds_needed, result.trainings)} would settle it"
    if endpoint.episodes_needed is None:
        most = f"even {MAX_EPISODES:,} episodes per task, the maximum, would not settle it"
        return f"{seen}; {most} if the difference is as observed"
    return f"{seen}; a baseline of {endpoint.episodes_needed:,} episodes per task would settle it"


def gate_notes(result: GateResult) -> tuple[str, ...]:
    """Say how the figures of a result were made, and what is not alike."""
    alpha = f"{100 * result.settings.alpha:g} %"
    unit, of_what = "episodes", "the paired difference"
    chance = f"at most {alpha}"
    if result.trainings:
        unit, of_what = "training seeds", "the difference of the methods, Student's t over seeds"
        chance = (
            f"about {alpha} where the seeds' values vary normally. Where some seeds fail to learn, "
            "no test over a few seeds keeps its level: look at each seed's value"
        )
    return (
        *(f"{NOT_ALIKE}: {note}." for note in result.notes),
        f"Brackets: 95 % interval of {of_what}, of the row alone. p: one-sided, that "
        f"the candidate is no worse. Chance of a false regression: {chance}. Only after a "
        "regression are the metrics of each task tested, adjusted together by Holm's method.",
        "regression: worse beyond the tolerance, and significant. no regression: the interval "
        f"excludes a worsening beyond the tolerance. not enough {unit}: neither; it fails "
        f"(exit {IncompleteCheckError.exit_code}) where what was seen is worse beyond the "
        "tolerance, with --strict always, with --lenient never.",
    )


def result_blocks(result: GateResult) -> Iterator[tables.Block]:
    """Yield what a gate's answer rests on."""
    yield from map(run_line, (result.baseline, result.candidate))
    yield ""
    if result.trainings:
        yield trainings_table(result.trainings, result.endpoint.effect)
    yield endpoint_table(result)
    yield from task_tables(result)
    yield ""
    yield from map(tables.NoteBlock, gate_notes(result))
