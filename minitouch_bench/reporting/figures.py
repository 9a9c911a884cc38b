"""The figures of a report as data; a page and files draw the same ones."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Estimate, Outcome
from minitouch_bench.errors import printable
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL
from minitouch_bench.reporting import charts
from minitouch_bench.reporting.charts import series_tone
from minitouch_bench.reporting.labels import PAPER_METHODS, RunSection, paper_value, task_title
from minitouch_bench.reporting.report import Report
from minitouch_bench.reporting.run_tables import (
    OUTCOME_TITLES,
    find_estimate,
    find_generalization,
    task_summary,
)
from minitouch_bench.runs.run import Run

SPLIT_OFFSET = 0.17
"""Half the distance between the held-out and the train mark of a row, rows."""

FAMILY_HEIGHT = 0.7
"""Share of a family's row that its runs take."""

OUTCOME_TONES = {
    Outcome.SUCCESS: "success",
    Outcome.LEFT_WORKSPACE: "left",
    Outcome.STEP_LIMIT: "limit",
    Outcome.POLICY_FAULT: "fault",
}


def report_figures(report: Report) -> tuple[charts.Figure, ...]:
    """Return the figures that every report has, of the tasks that have them."""
    sections, runs = report.sections, _run_legend(report.sections)
    goals = [task for task in report.tasks if task in GOAL_TASKS]
    figures = (
        charts.Figure(
            "against-the-paper",
            "Against the paper",
            "Filled: this report, with its 95 % interval. Hollow: the paper's own values, from "
            "other episodes and object sets.",
            tuple(_estimate_plot(task, sections) for task in report.tasks),
        ),
        charts.Figure(
            "episode-steps",
            "How long episodes last",
            "Share of a run's episodes by number of control steps, and by how they ended.",
            # Playing always lasts until the step limit.
            tuple(_steps_plot(task, sections) for task in goals),
            tuple(
                charts.LegendItem(OUTCOME_TITLES[outcome], tone)
                for outcome, tone in OUTCOME_TONES.items()
            ),
        ),
        charts.Figure(
            "touch-over-time",
            "Touch over time",
            "Mean ticks in contact at each control step, over the episodes that reached it; "
            "faint where fewer than a tenth of the episodes are left.",
            tuple(touch_plot(task, [s.run for s in sections]) for task in report.tasks),
            runs,
        ),
    )
    return tuple(figure for figure in figures if figure.plots)


def split_figures(report: Report) -> tuple[charts.Figure, ...]:
    """Return held-out beside train shapes, as in the paper's Figure 11, and the families."""
    sections = report.sections
    compared = {
        result.task for section in sections for result in section.run.summary.generalization
    }
    tasks = [task for task in report.tasks if task in compared]
    if not tasks:
        return ()
    legend = (
        charts.LegendItem("held-out shapes", "muted", "circle"),
        charts.LegendItem("train shapes", "muted", "circle", is_hollow=True),
        *_run_legend(sections),
    )
    return (
        charts.Figure(
            "held-out-beside-train",
            "Held-out beside train shapes",
            "Each with its 95 % interval, in the manner of the paper's Figure 11.",
            tuple(_split_plot(task, metric, sections) for task in tasks for metric in _pair(task)),
            legend,
        ),
        charts.Figure(
            "families",
            "Families of shapes",
            "Success, in Playing touch share, by family. A ring around a dot: no difference.",
            tuple(_family_plot(task, sections) for task in tasks),
            legend,
        ),
    )


def _pair(task: str) -> tuple[str, str]:
    """Return the two metrics that the paper's Figure 11 and its text compare."""
    return (ranking_metric(task), "episode_steps" if task in GOAL_TASKS else "object_movement")


def _run_legend(sections: Sequence[RunSection]) -> tuple[charts.LegendItem, ...]:
    return charts.run_legend([section.name for section in sections]) if len(sections) > 1 else ()


def _estimate_plot(task: str, sections: Sequence[RunSection]) -> charts.Plot:
    """Draw an estimate of each run with its interval, and the paper's values below."""
    metric = ranking_metric(task)
    printed = [(method, paper_value(task, metric, method)) for method in PAPER_METHODS]
    paper = [(method, v.number) for method, v in printed if v and v.number is not None]
    estimates = [find_estimate(section.run, task, metric) for section in sections]
    marks: list[charts.Mark] = []
    for row, estimate in enumerate(estimates):
        if estimate is not None:
            marks += charts.estimate_marks(row, row, estimate)
    for row, (_, value) in enumerate(paper, start=len(sections)):
        marks.append(charts.Dot(value, row, "muted", "diamond", 7, is_hollow=True))
    highest = [e.high for e in estimates if e] + [value for _, value in paper]
    rows = charts.name_axis(_names(sections), [method for method, _ in paper])
    chart = charts.Chart(
        _metric_axis(task, metric, highest), rows, tuple(marks), charts.ROW * len(rows.ticks)
    )
    what = f"{task_title(task)}: {METRICS[metric].label} with 95 % intervals"
    return charts.Plot(task_title(task), what, (chart,))


def _steps_plot(task: str, sections: Sequence[RunSection]) -> charts.Plot:
    panels = {}
    for name, section in zip(_names(sections), sections, strict=True):
        episodes = [episode for episode in section.run.rows if episode.task == task]
        panels[name if len(sections) > 1 else ""] = {
            tone: np.array([e.steps for e in episodes if e.outcome is outcome], np.int64)
            for outcome, tone in OUTCOME_TONES.items()
        }
    return steps_plot(task, panels)


def steps_plot(task: str, panels: Mapping[str, Mapping[str, NDArray[np.int64]]]) -> charts.Plot:
    """Draw the control steps of a task's episodes, a panel by title, with an array per tone."""
    what = f"{task_title(task)}: distribution of episode steps by ending"
    return charts.Plot(
        task_title(task), what, charts.step_histograms(panels, PROTOCOL.task(task).max_steps)
    )


def touch_plot(task: str, runs: Sequence[Run]) -> charts.Plot:
    """Draw a task's touch curve of each run, faint where few episodes reached the step."""
    summaries = [task_summary(run, task) for run in runs]
    curves = [
        (summary.touch_curve, summary.touch_curve_episodes) if summary else ((), ())
        for summary in summaries
    ]
    what = f"{task_title(task)}: mean contact ticks at each control step"
    return charts.Plot(
        task_title(task), what, (charts.touch_chart(curves, PROTOCOL.task(task).max_steps),)
    )


def _split_plot(task: str, metric: str, sections: Sequence[RunSection]) -> charts.Plot:
    """Draw a metric on held-out shapes (filled) above train shapes (hollow), a row per run."""
    marks: list[charts.Mark] = []
    highest = [0.0]
    for row, section in enumerate(sections):
        result = find_generalization(section.run, task)
        gap = result.gaps.get(metric) if result else None
        if gap is not None:
            for estimate, offset in ((gap.held_out, -SPLIT_OFFSET), (gap.train, SPLIT_OFFSET)):
                hollow = offset > 0
                marks += charts.estimate_marks(
                    row, row + offset, estimate, size=7, is_hollow=hollow
                )
                highest.append(estimate.high)
    rows, x = charts.name_axis(_names(sections)), _metric_axis(task, metric, highest)
    label = METRICS[metric].label
    return charts.Plot(
        f"{task_title(task)}: {label.lower()}",
        f"{task_title(task)}: {label} on each split",
        (charts.Chart(x, rows, tuple(marks), 1.4 * charts.ROW * len(sections)),),
    )


def _family_plot(task: str, sections: Sequence[RunSection]) -> charts.Plot:
    """Draw each family's value on held-out (filled) and train shapes (hollow)."""
    results = [find_generalization(section.run, task) for section in sections]
    compared = [result for result in results if result is not None]
    families = sorted({family for result in compared for family in result.families})
    # The runs of a family stand close together, so that the families stay apart.
    offsets = (np.arange(len(sections)) - (len(sections) - 1) / 2) * FAMILY_HEIGHT / len(sections)
    marks: list[charts.Mark] = []
    highest = [0.0]
    for index, result in enumerate(results):
        for line, family in enumerate(families):
            both = result.families.get(family) if result else None
            if both is not None:
                row = line + float(offsets[index])
                marks += _family_marks(index, row, both.held_out, both.train)
                highest += [estimate.value for estimate in (both.held_out, both.train) if estimate]
    rows = charts.name_axis(charts.short_names([printable(family) for family in families]))
    x = _metric_axis(task, compared[0].family_metric, highest)
    height = (8 + 12 * len(sections)) * len(families)
    what = f"{task_title(task)}: each family on each split"
    return charts.Plot(task_title(task), what, (charts.Chart(x, rows, tuple(marks), height),))


def _family_marks(
    index: int, row: float, held_out: Estimate | None, train: Estimate | None
) -> Iterator[charts.Mark]:
    """Mark a family's two values, joined by a line; a ring around a dot means equal."""
    if held_out is not None and train is not None:
        points = ((held_out.value, row), (train.value, row))
        yield charts.Line(points, series_tone(index), 1.2, 0.4)
    if train is not None:
        yield charts.run_dot(index, train.value, row, size=9, is_hollow=True)
    if held_out is not None:
        yield charts.run_dot(index, held_out.value, row, size=5)


def _names(sections: Sequence[RunSection]) -> tuple[str, ...]:
    return charts.short_names([section.name for section in sections])


def _metric_axis(task: str, metric: str, values: Sequence[float]) -> charts.Axis:
    """Name the axis of a metric and start it at 0; a share runs to 1."""
    label = f"{METRICS[metric].label}, {METRICS[metric].unit_in(task)}"
    return (
        charts.share_axis(label)
        if METRICS[metric].is_share
        else charts.value_axis(label, max(values, default=0.0))
    )
