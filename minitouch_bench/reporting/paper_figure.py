"""A figure for a paper: the intervals of several runs, grouped by task, drawn by matplotlib."""

import io
from pathlib import Path
from typing import Any

from minitouch_bench.errors import UsageError
from minitouch_bench.files import write_file
from minitouch_bench.machine import require
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.reporting import labels
from minitouch_bench.reporting.report import Report
from minitouch_bench.reporting.report_tables import find_estimate

FIGURE_SUFFIXES = (".svg", ".pdf", ".png")

POINT_COLORS = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#aa4488",
    "#b87a00",
    "#5d2f0c",
    "#56b4e9",
    "#878d96",
)
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


def figure_suffix(path: Path) -> str:
    """Return the kind of a figure.

    Raises:
        UsageError: it is none that can be written.
    """
    if path.suffix not in FIGURE_SUFFIXES:
        raise UsageError(f"--figure is a file {', '.join(FIGURE_SUFFIXES)}, not '{path.name}'")
    return path.suffix


def write_figure(report: Report, metrics: tuple[str, ...], path: Path) -> None:
    """Draw a panel for each metric: tasks across, each run's estimate with its 95 % interval.

    ``metrics``: () for those that rank the tasks.

    Raises:
        UsageError: another kind of file, or no run has a value.
        MissingExtraError: matplotlib is not installed.
        RunDirectoryError: the file cannot be written.
    """
    suffix = figure_suffix(path)
    require("matplotlib", "figure")
    from matplotlib import rc_context  # noqa: PLC0415  an extra
    from matplotlib.figure import Figure  # noqa: PLC0415

    wanted = metrics or tuple(dict.fromkeys(map(ranking_metric, report.tasks)))
    panels = {
        metric: tasks
        for metric in wanted
        if (
            tasks := [
                task
                for task in report.tasks
                if (metrics or ranking_metric(task) == metric) and _has_value(report, task, metric)
            ]
        )
    }
    if not panels:
        raise UsageError("no run has a value of these metrics in these tasks: nothing to draw")
    with rc_context(PLOT_SETTINGS):
        widths = [len(tasks) for tasks in panels.values()]
        size = (1.2 + sum(0.5 + 0.9 * width for width in widths), 3.0)
        figure = Figure(size, layout="constrained")
        axes = figure.subplots(1, len(panels), squeeze=False, width_ratios=widths)[0]
        for one, (metric, tasks) in zip(axes, panels.items(), strict=True):
            _draw_panel(one, report, metric, tasks)
        handles, names = axes[0].get_legend_handles_labels()
        if len(names) > 1:
            columns = max(1, int(size[0] / 1.6))
            figure.legend(handles, names, loc="outside upper center", ncols=columns)
        content = io.BytesIO()
        figure.savefig(content, format=suffix[1:], metadata=NO_DATE[suffix])
    write_file(path, content.getvalue())


def _has_value(report: Report, task: str, metric: str) -> bool:
    return any(find_estimate(section.run, task, metric) for section in report.sections)


def _draw_panel(axes: Any, report: Report, metric: str, tasks: list[str]) -> None:
    """Draw one metric; every run has its place in each group, whether or not it has a value."""
    count = len(report.sections)
    for index, section in enumerate(report.sections):
        found = [find_estimate(section.run, task, metric) for task in tasks]
        points = [
            (group + GROUP_WIDTH * ((index + 0.5) / count - 0.5), estimate)
            for group, estimate in enumerate(found)
            if estimate
        ]
        values = [estimate.value for _, estimate in points]
        ends = [
            [max(0.0, estimate.value - estimate.low) for _, estimate in points],
            [max(0.0, estimate.high - estimate.value) for _, estimate in points],
        ]
        color, mark = POINT_COLORS[index % len(POINT_COLORS)], POINT_MARKS[index % len(POINT_MARKS)]
        axes.errorbar(
            [x for x, _ in points], values, ends, label=section.name.replace("$", r"\$"),
            fmt=mark, color=color, markersize=4, capsize=2, elinewidth=1.2,
        )  # fmt: skip
    axes.set_xticks(range(len(tasks)), [labels.task_title(task) for task in tasks])
    axes.set_xlim(-0.5, len(tasks) - 0.5)
    axes.set_ylabel(f"{METRICS[metric].label} ({METRICS[metric].unit_in(tasks[0])})")
    if METRICS[metric].is_fraction:
        axes.set_ylim(-0.02, 1.02)
    else:
        axes.set_ylim(bottom=0)
    axes.grid(axis="y", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
