"""The figures of a report as data, of a row's page too, and a figure for a paper as a file."""

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Episode
from minitouch_bench.errors import UsageError
from minitouch_bench.files import write_file
from minitouch_bench.machine import require
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.summary import TaskResult
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL
from minitouch_bench.reporting import charts, labels, report_tables
from minitouch_bench.reporting.endings import Ending, ending_of
from minitouch_bench.reporting.labels import RunSection, task_title
from minitouch_bench.runs.run import Run

BIN = 10
"""Control steps in one bar of a histogram of episode steps."""

FEW = 0.1
"""Share of the episodes below which a curve is drawn faintly."""

FEWEST = 4
"""Episodes of which a middle half can be drawn."""

ENDING_NAMES = {
    Ending.SUCCEEDED: "succeeded",
    Ending.TOUCHED_FAILED: "failed",
    Ending.LEFT: "left",
    Ending.FAULT: "fault",
}
"""Endings with touch, as they fit beside a chart."""

FREE_AIR = 1.0
"""What a finger's force is where it touches nothing, N: its own weight."""


def report_figures(
    sections: Sequence[RunSection], tasks: Sequence[str]
) -> tuple[charts.Figure, ...]:
    """Return the figures that every report has, of the tasks that have them."""
    goals = [task for task in tasks if task in GOAL_TASKS]  # Playing lasts until the step limit
    played = {task: _panels(task, sections) for task in goals}
    figures = (
        steps_figure(played),
        touch_figure(tasks, [section.run for section in sections], _run_legend(sections)),
        _force_figure(sections, tasks),
        peak_figure(played),
    )
    return tuple(figure for figure in figures if figure.plots)


def _run_legend(sections: Sequence[RunSection]) -> tuple[charts.LegendItem, ...]:
    """Name the runs by their colors; none is needed for a single run."""
    items = (
        charts.LegendItem(section.name, charts.series_tone(i)) for i, section in enumerate(sections)
    )
    return tuple(items) if len(sections) > 1 else ()


def _panels(task: str, sections: Sequence[RunSection]) -> dict[str, list[Episode]]:
    """Return a task's episodes of each run, by its name where there are several."""
    return {
        section.name if len(sections) > 1 else "": [
            episode for episode in section.run.rows if episode.task == task
        ]
        for section in sections
    }


def steps_figure(played: Mapping[str, Mapping[str, Sequence[Episode]]]) -> charts.Figure:
    """Draw how long episodes last, colored by how they ended; ``played`` by task and panel."""
    found = {
        ending_of(row) for panels in played.values() for rows in panels.values() for row in rows
    }
    return charts.Figure(
        "episode-steps",
        "How long episodes last",
        "Share of the episodes by number of control steps, and by how they ended.",
        tuple(steps_plot(task, panels) for task, panels in played.items()),
        tuple(ending.legend for ending in Ending if ending in found),
    )


def steps_plot(task: str, panels: Mapping[str, Sequence[Episode]]) -> charts.Plot:
    """Draw the share of a task's episodes by control steps; ``panels``: episodes by title.

    What is beyond the task's limit is drawn at it: a stranger's file can say any number.
    """
    # One bar more than the limit: an episode of 200 steps gets its own, not that of 190-199.
    edges = np.arange(0, PROTOCOL.task(task).max_steps + 2 * BIN, BIN)
    tops = {}
    for title, episodes in panels.items():
        counts = np.zeros((len(Ending), len(edges) - 1))
        for row, ending in enumerate(Ending):
            steps = [min(e.steps, edges[-1]) for e in episodes if ending_of(e) is ending]
            counts[row] = np.histogram(steps, edges)[0]
        tops[title] = np.cumsum(100 * counts / max(1.0, counts.sum()), axis=0)
    highest = max(float(stack[-1].max()) for stack in tops.values())
    x = charts.even_axis("Control steps", 0, int(edges[-1]), 50)
    y = charts.value_axis("Episodes, %", highest, intervals=3)
    drawn = tuple(
        charts.Chart(x, y, tuple(_bars(stack, edges)), 76, title) for title, stack in tops.items()
    )
    what = f"{task_title(task)}: distribution of episode steps by ending"
    return charts.Plot(task_title(task), what, drawn)


def _bars(tops: NDArray[np.float64], edges: NDArray[np.int64]) -> Iterator[charts.Blocks]:
    """Yield the bars of each ending; ``tops``: where they end, (endings, bars)."""
    bottoms = np.vstack([np.zeros(len(edges) - 1), tops[:-1]])
    for ending, low, high in zip(Ending, bottoms, tops, strict=True):
        boxes = tuple(
            (left + 0.6, bottom, left + BIN - 0.6, top)
            for left, bottom, top in zip(edges.tolist(), low.tolist(), high.tolist(), strict=False)
            if top > bottom
        )
        if boxes:
            yield charts.Blocks(boxes, ending.tone)


def touch_figure(
    tasks: Sequence[str],
    runs: Sequence[Run],
    legend: tuple[charts.LegendItem, ...] = (),
    more: str = "",
) -> charts.Figure:
    """Draw the touch curves of runs; ``more`` ends the text below."""
    return charts.Figure(
        "touch-over-time",
        "Touch over time",
        "Mean ticks in contact at each control step, over the episodes that reached it; faint "
        f"where fewer than a tenth of the episodes are left{more}.",
        tuple(_time_plot(task, runs, "Ticks per step", _touch_curve) for task in tasks),
        legend,
    )


def _force_figure(sections: Sequence[RunSection], tasks: Sequence[str]) -> charts.Figure:
    """Draw what the fingers felt over time."""
    text = (
        "The larger of the two fingers' forces at the end of each control step: median (line) and "
        "middle half (band) of the episodes that reached it; faint where fewer than a tenth, or "
        f"fewer than {FEWEST}, are left. A finger in free air reads about {FREE_AIR:g} N, its own "
        f"weight. Each of a force's three components is cut off at {labels.force_limits(tasks)}."
    )
    altered = [one.name for one in sections if one.run.plan.conditions.changes_forces]
    if altered:
        names = labels.listed(altered)
        text += f" All are true forces, also where the policy was given others: {names}."
    runs = [section.run for section in sections]
    plots = tuple(_time_plot(task, runs, "Force, N", _quartiles, FREE_AIR) for task in tasks)
    return charts.Figure("forces", "What the fingers felt", text, plots, _run_legend(sections))


def _touch_curve(result: TaskResult) -> list[Sequence[float]]:
    return [result.touch_curve]


def _quartiles(result: TaskResult) -> list[list[float]]:
    steps = result.force_curve
    return [[s.median for s in steps], [s.lower for s in steps], [s.upper for s in steps]]


def _time_plot(
    task: str,
    runs: Sequence[Run],
    label: str,
    curves_of: Callable[[TaskResult], Sequence[Sequence[float]]],
    highest: float = 0.0,
) -> charts.Plot:
    """Draw a value at each control step, a line per run, faint where few episodes are left.

    ``curves_of``: the line, and the lower and upper edge of the band around it if there is one.
    ``highest``: the value that the axis reaches at least.
    """
    marks: list[charts.Mark] = []
    longest = 1
    for index, run in enumerate(runs):
        result, tone = report_tables.task_summary(run, task), charts.series_tone(index)
        if result is None or not result.curve_episodes:
            continue
        reached, curves = result.curve_episodes, curves_of(result)
        if {*map(len, curves)} != {len(reached)}:
            continue  # an edited run, which no report should fail at
        longest, highest = max(longest, len(reached)), max(highest, *map(max, curves))
        least = max(FEW * reached[0], FEWEST if len(curves) > 1 else 0)
        for part, is_faint in _parts(reached, least):
            line, *band = (tuple(enumerate(values))[part] for values in curves)
            if band:
                corners = (*band[0], *reversed(band[1]))
                marks.append(charts.Band(corners, tone, 0.12 if is_faint else 0.25))
            marks.append(charts.Line(line, tone, *((1.1, 0.35) if is_faint else (1.4,))))
    title, x = task_title(task), charts.value_axis("Control steps", longest)
    chart = charts.Chart(x, charts.value_axis(label, highest), tuple(marks), 112)
    return charts.Plot(title, f"{title}: {label.lower()}, by control step", (chart,))


def _parts(reached: Sequence[int], least: float) -> Iterator[tuple[slice, bool]]:
    """Yield the part of a curve that enough episodes reached, then the rest, which is faint."""
    certain = next((step for step, number in enumerate(reached) if number < least), len(reached))
    if certain:
        yield slice(0, certain), False
    if certain < len(reached):
        yield slice(max(0, certain - 1), len(reached)), True


def peak_figure(played: Mapping[str, Mapping[str, Sequence[Episode]]]) -> charts.Figure:
    """Draw peak force by how episodes ended, where two endings have FEWEST episodes with touch.

    ``played`` by task and panel.
    """
    plots = []
    for task, panels in played.items():
        shown = {name: p for name, rows in panels.items() if len(p := _peaks(rows)) > 1}
        if shown:
            plots.append(_peak_plot(task, shown))
    text = (
        "The largest force of an episode by how it ended, episodes that touched: median (dot), "
        "middle half (thick) and range (thin) of each ending that has "
        f"{FEWEST} episodes or more. Each of a force's three components is cut off at "
        f"{labels.force_limits(tuple(played))}, so a force is at most √3 times that."
    )
    return charts.Figure("peak-forces", "How hard it pressed, and the outcome", text, tuple(plots))


def _peaks(episodes: Sequence[Episode]) -> dict[Ending, list[float]]:
    """Return the peak forces (N) of the episodes that touched, by ending."""
    peaks: dict[Ending, list[float]] = {}
    for episode in episodes:
        if episode.peak_force is not None:
            peaks.setdefault(ending_of(episode), []).append(episode.peak_force)
    return {
        ending: peaks[ending] for ending in ENDING_NAMES if len(peaks.get(ending, ())) >= FEWEST
    }


def _peak_plot(task: str, panels: Mapping[str, Mapping[Ending, Sequence[float]]]) -> charts.Plot:
    highest = max(max(peaks) for panel in panels.values() for peaks in panel.values())
    limit = PROTOCOL.task(task).force_limit
    x = charts.value_axis("Peak force, N", highest)
    drawn, cut, touched = [], 0, 0
    for title, panel in panels.items():
        marks: list[charts.Mark] = []
        for row, (ending, peaks) in enumerate(panel.items()):
            low, lower, median, upper, high = np.percentile(peaks, (0, 25, 50, 75, 100)).tolist()
            marks.append(charts.Line(((low, row), (high, row)), ending.tone, 1.2))
            marks.append(charts.Line(((lower, row), (upper, row)), ending.tone, 5, 0.5))
            marks.append(charts.Spots(((median, row),), ending.tone, 8))
            cut += sum(peak >= limit for peak in peaks)
            touched += len(peaks)
        names = [f"{ENDING_NAMES[ending]} ({len(peaks)})" for ending, peaks in panel.items()]
        rows = charts.name_axis(names)
        drawn.append(charts.Chart(x, rows, tuple(marks), charts.ROW * len(panel), title))
    note = (
        f"{cut} of {touched} peaks are at {limit:g} N or above, so possibly larger." if cut else ""
    )
    what = f"{task_title(task)}: peak force by ending"
    return charts.Plot(task_title(task), what, tuple(drawn), note)


# A figure for a paper, drawn by matplotlib

POINT_COLORS = (
    "#0072b2", "#d55e00", "#009e73", "#aa4488", "#b87a00", "#5d2f0c", "#56b4e9", "#878d96",
)  # fmt: skip
POINT_MARKS = "os^vDP*X"
"""Of the runs, in turn: a figure printed in gray tells them apart too."""

GROUP_WIDTH = 0.7
"""Room of the runs of one task, where the tasks are 1 apart."""

PLOT_SETTINGS: Any = {
    "svg.hashsalt": "minitouch-bench", "svg.fonttype": "none", "pdf.fonttype": 42,
    "axes.spines.top": False, "axes.spines.right": False, "font.size": 9,
    "legend.frameon": False, "savefig.dpi": 300,
}  # fmt: skip
"""The same runs give the same file; text stays text."""

NO_DATE: dict[str, dict[str, Any]] = {
    ".svg": {"Date": None}, ".pdf": {"CreationDate": None}, ".png": {},
}  # fmt: skip
"""Metadata without a date, by the kinds of files that can be written."""


def check_figure(path: Path) -> None:
    """Refuse a figure of a kind that cannot be written.

    Raises:
        UsageError: it is not one of NO_DATE.
    """
    if path.suffix not in NO_DATE:
        raise UsageError(f"--figure is a file {', '.join(NO_DATE)}, not '{path.name}'")


def write_figure(
    sections: Sequence[RunSection], tasks: Sequence[str], metrics: Sequence[str], path: Path
) -> None:
    """Draw a panel for each metric and unit: tasks across, estimates with their 95 % intervals.

    ``metrics``: () for those that rank the tasks. ``path``: see ``check_figure``.

    Raises:
        UsageError: no run has a value.
        MissingExtraError: matplotlib is not installed.
        RunDirectoryError: the file cannot be written.
    """
    require("matplotlib", "figure")
    from matplotlib import rc_context  # noqa: PLC0415  an extra
    from matplotlib.figure import Figure  # noqa: PLC0415

    panels: dict[tuple[str, str], list[str]] = {}
    for task in tasks:
        for metric in metrics or [ranking_metric(task)]:
            if any(report_tables.find_estimate(section.run, task, metric) for section in sections):
                panels.setdefault((metric, METRICS[metric].unit_in(task)), []).append(task)
    if not panels:
        raise UsageError("no run has a value of these metrics in these tasks: nothing to draw")
    with rc_context(PLOT_SETTINGS):
        widths = [len(shown) for shown in panels.values()]
        size = (1.2 + sum(0.5 + 0.9 * width for width in widths), 3.0)
        figure = Figure(size, layout="constrained")
        axes = figure.subplots(1, len(panels), squeeze=False, width_ratios=widths)[0]
        for one, ((metric, unit), shown) in zip(axes, panels.items(), strict=True):
            _draw_panel(one, sections, metric, shown)
            one.set_ylabel(f"{METRICS[metric].label} ({unit})")
        handles, names = axes[0].get_legend_handles_labels()
        if len(names) > 1:
            columns = max(1, int(size[0] / 1.6))
            figure.legend(handles, names, loc="outside upper center", ncols=columns)
        content = io.BytesIO()
        figure.savefig(content, format=path.suffix[1:], metadata=NO_DATE[path.suffix])
    write_file(path, content.getvalue())


def _draw_panel(axes: Any, sections: Sequence[RunSection], metric: str, tasks: list[str]) -> None:
    """Draw one metric; every run has its place in each group, whether or not it has a value."""
    count = len(sections)
    for index, section in enumerate(sections):
        place = GROUP_WIDTH * ((index + 0.5) / count - 0.5)
        found = {
            group + place: estimate
            for group, task in enumerate(tasks)
            if (estimate := report_tables.find_estimate(section.run, task, metric))
        }
        values = [one.value for one in found.values()]
        below = [max(0.0, one.value - one.low) for one in found.values()]
        above = [max(0.0, one.high - one.value) for one in found.values()]
        color, mark = POINT_COLORS[index % len(POINT_COLORS)], POINT_MARKS[index % len(POINT_MARKS)]
        axes.errorbar(
            list(found), values, (below, above), label=section.name.replace("$", r"\$"),
            fmt=mark, color=color, markersize=4, capsize=2, elinewidth=1.2,
        )  # fmt: skip
    axes.set_xticks(range(len(tasks)), [task_title(task) for task in tasks])
    axes.set_xlim(-0.5, len(tasks) - 0.5)
    axes.set_ylim((-0.02, 1.02) if METRICS[metric].is_fraction else (0, None))
    axes.grid(axis="y", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
