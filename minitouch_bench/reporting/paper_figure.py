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


def figure_suffix(path: Path) -> str:
    """Return the kind of a figure.

    Raises:
        UsageError: it is none that can be written.
    """
    if path.suffix not in NO_DATE:
        raise UsageError(f"--figure is a file {', '.join(NO_DATE)}, not '{path.name}'")
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

    panels: dict[str, list[str]] = {}
    for task in report.tasks:
        for metric in metrics or [ranking_metric(task)]:
            if any(find_estimate(section.run, task, metric) for section in report.sections):
                panels.setdefault(metric, []).append(task)
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


def _draw_panel(axes: Any, report: Report, metric: str, tasks: list[str]) -> None:
    """Draw one metric; every run has its place in each group, whether or not it has a value."""
    count = len(report.sections)
    for index, section in enumerate(report.sections):
        place = GROUP_WIDTH * ((index + 0.5) / count - 0.5)
        found = {
            group + place: estimate
            for group, task in enumerate(tasks)
            if (estimate := find_estimate(section.run, task, metric))
        }
        values = [one.value for one in found.values()]
        below = [max(0.0, one.value - one.low) for one in found.values()]
        above = [max(0.0, one.high - one.value) for one in found.values()]
        color, mark = POINT_COLORS[index % len(POINT_COLORS)], POINT_MARKS[index % len(POINT_MARKS)]
        axes.errorbar(
            list(found), values, (below, above), label=section.name.replace("$", r"\$"),
            fmt=mark, color=color, markersize=4, capsize=2, elinewidth=1.2,
        )  # fmt: skip
    axes.set_xticks(range(len(tasks)), [labels.task_title(task) for task in tasks])
    axes.set_xlim(-0.5, len(tasks) - 0.5)
    axes.set_ylabel(f"{METRICS[metric].label} ({METRICS[metric].unit_in(tasks[0])})")
    axes.set_ylim((-0.02, 1.02) if METRICS[metric].is_fraction else (0, None))
    axes.grid(axis="y", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
