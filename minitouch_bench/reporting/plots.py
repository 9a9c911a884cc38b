"""Plots of a report as inline SVG.

Colours are drawn as sentinels and replaced by the page's CSS variables, so that one drawing
serves light and dark pages. Text stays text: it takes the page's font and can be read aloud.
"""

import html
import io
import re
import warnings
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from minitouch_bench.metrics.definitions import METRICS, unit_of
from minitouch_bench.records import EpisodeMetrics, Estimate, Outcome, TaskSummary
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.novel_shapes import find_generalization
from minitouch_bench.reporting.paper import PAPER_METHODS, paper_value
from minitouch_bench.reporting.report import RunSection
from minitouch_bench.reporting.tables import OUTCOME_TITLES, find_estimate, task_summary

INK, MUTED, RULE = "#010201", "#010202", "#010203"
SERIES = tuple(f"#01031{digit}" for digit in range(6))
OUTCOMES = dict(zip(OUTCOME_TITLES, (f"#01042{digit}" for digit in range(4)), strict=True))
_CSS = {
    INK: "currentColor",
    MUTED: "var(--muted)",
    RULE: "var(--rule)",
    **{colour: f"var(--series-{place})" for place, colour in enumerate(SERIES)},
    **{colour: f"var(--outcome-{place})" for place, colour in enumerate(OUTCOMES.values())},
}
MARKERS = ("o", "s", "^", "v", "P", "X")

STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "minitouch-bench",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 11.0,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "text.color": INK,
    "text.parse_math": False,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": MUTED,
    "axes.labelsize": 10.5,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 10.5,
    "ytick.labelsize": 10.5,
    "grid.color": RULE,
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
}
WIDTH = 3.4
"""Width of a plot, inches; the page scales it."""

STEP_LIMIT = 200
BIN = 10
"""Control steps in one bar of the distribution of episode steps."""

FEW = 0.1
"""Share of episodes below which the touch curve is drawn faintly."""

LONGEST_NAME = 16

FAMILY_HEIGHT = 0.7
"""Share of a family's row that its runs take."""

SPLIT_OFFSET = 0.17
"""Half the distance between the held-out and the train mark of a row, rows."""


def estimate_plot(task: str, metric: str, sections: Sequence[RunSection]) -> str:
    """Draw an estimate of each run with its interval, and the paper's values below.

    Values of the paper in another unit are left out.
    """
    printed = [(method, paper_value(task, metric, method)) for method in PAPER_METHODS]
    numbers = [(method, value.number) for method, value in printed if value is not None]
    paper = [(method, number) for method, number in numbers if number is not None]
    rows = len(sections) + len(paper)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 0.85 + 0.3 * rows), layout="constrained")
        axes = figure.subplots()
        for place, section in enumerate(sections):
            estimate = find_estimate(section.run, task, metric)
            if estimate is not None:
                colour = SERIES[place % len(SERIES)]
                axes.plot([estimate.low, estimate.high], [place, place], color=colour, lw=2.4)
                marker = MARKERS[place % len(MARKERS)]
                axes.plot(estimate.value, place, marker, color=colour, ms=8)
        for place, (_, value) in enumerate(paper, start=len(sections)):
            axes.plot(value, place, "D", mfc="none", mec=MUTED, ms=5.5, mew=1.2)
        names = [_short(section.name) for section in sections]
        axes.set_yticks(range(rows), [*names, *(method for method, _ in paper)])
        axes.set_ylim(rows - 0.5, -0.5)
        _metric_axis(axes, task, metric)
        _quiet_rows(axes, len(sections))
        return _svg(figure, f"{task_title(task)}: {METRICS[metric].label} with 95 % intervals")


def steps_plot(task: str, sections: Sequence[RunSection]) -> str:
    """Draw what share of the episodes took how many control steps, split by how they ended."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 0.9 + 1.3 * len(sections)), layout="constrained")
        grid = figure.subplots(len(sections), 1, sharex=True, sharey=True, squeeze=False)
        for axes, section in zip(grid[:, 0], sections, strict=True):
            _histogram(axes, [e for e in section.run.episodes if e.task == task])
            if len(sections) > 1:
                axes.set_title(_short(section.name), loc="left", fontsize=10.5, color=INK)
        grid[-1, 0].set_xlabel("Episode steps (control steps)")
        figure.supylabel("Episodes (%)", fontsize=10.5, color=MUTED)
        return _svg(figure, f"{task_title(task)}: distribution of episode steps by outcome")


def touch_plot(task: str, sections: Sequence[RunSection]) -> str:
    """Draw the mean contact ticks at each control step, the runs overlaid."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 2.3), layout="constrained")
        axes = figure.subplots()
        for place, section in enumerate(sections):
            summary = task_summary(section.run, task)
            if summary is not None and summary.touch_curve:
                _touch_curve(axes, summary, SERIES[place % len(SERIES)])
        axes.set_xlim(0, None)
        axes.set_ylim(0, None)
        axes.set_xlabel("Time (control steps)")
        axes.set_ylabel("Contact (ticks per step)")
        axes.grid(axis="y")
        return _svg(figure, f"{task_title(task)}: mean contact ticks at each control step")


def split_plot(task: str, metric: str, sections: Sequence[RunSection]) -> str:
    """Draw a metric on held-out shapes (filled) above train shapes (hollow), a row a run."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 0.85 + 0.42 * len(sections)), layout="constrained")
        axes = figure.subplots()
        for place, section in enumerate(sections):
            result = find_generalization(section.run, task)
            gap = result.gaps.get(metric) if result else None
            if gap is not None:
                _split_marks(axes, place, place, (gap.held_out, gap.train))
        _name_rows(axes, [_short(section.name) for section in sections])
        _metric_axis(axes, task, metric)
        return _svg(figure, f"{task_title(task)}: {METRICS[metric].label} on each split")


def family_plot(task: str, sections: Sequence[RunSection]) -> str:
    """Draw each family's figure on held-out (filled) and train shapes (hollow)."""
    results = [find_generalization(section.run, task) for section in sections]
    found = [result for result in results if result is not None]
    families = sorted({family for result in found for family in result.families})
    with mpl.rc_context(STYLE):
        row = 0.14 + 0.16 * len(sections)
        figure = Figure(figsize=(WIDTH, 0.85 + row * len(families)), layout="constrained")
        axes = figure.subplots()
        # The runs of a family stand close together, so that the families stay apart.
        runs = (np.arange(len(sections)) - (len(sections) - 1) / 2) * FAMILY_HEIGHT / len(sections)
        for place, result in enumerate(results):
            for line, family in enumerate(families):
                both = result.families.get(family) if result else None
                if both is not None:
                    _family_marks(axes, line + runs[place], place, (both.held_out, both.train))
        _name_rows(axes, [_short(printable(family)) for family in families])
        _metric_axis(axes, task, found[0].family_metric)
        return _svg(figure, f"{task_title(task)}: each family on each split")


def _split_marks(axes: Axes, row: float, place: int, splits: tuple[Estimate, Estimate]) -> None:
    """Draw two estimates with their intervals, the first filled and above."""
    colour, marker = SERIES[place % len(SERIES)], MARKERS[place % len(MARKERS)]
    offsets = (-SPLIT_OFFSET, SPLIT_OFFSET)
    for found, offset, fill in zip(splits, offsets, (colour, "none"), strict=True):
        height = row + offset
        axes.plot([found.low, found.high], [height, height], color=colour, lw=1.6, alpha=0.55)
        style: dict[str, Any] = {
            "color": colour,
            "mfc": fill,
            "ms": 7,
            "mew": 1.5,
            "clip_on": False,
        }
        axes.plot(found.value, height, marker, **style)


def _family_marks(
    axes: Axes, row: float, place: int, splits: tuple[Estimate | None, Estimate | None]
) -> None:
    """Draw two figures of a family joined by a line; a ring around a dot means equal."""
    colour, marker = SERIES[place % len(SERIES)], MARKERS[place % len(MARKERS)]
    # A mark at the end of the axis is drawn whole.
    style: dict[str, Any] = {"color": colour, "clip_on": False}
    held_out, train = splits
    if held_out is not None and train is not None:
        axes.plot([held_out.value, train.value], [row, row], color=colour, lw=1.2, alpha=0.4)
    if train is not None:
        axes.plot(train.value, row, marker, mfc="none", ms=8.5, mew=1.3, **style)
    if held_out is not None:
        axes.plot(held_out.value, row, marker, ms=4.5, **style)


def _name_rows(axes: Axes, names: Sequence[str]) -> None:
    """Name the rows from the top down, in full ink."""
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    _quiet_rows(axes, len(names))


def _metric_axis(axes: Axes, task: str, metric: str) -> None:
    """Name the axis of a metric and start it at 0; a share runs to 1."""
    axes.set_xlim(*((-0.02, 1.02) if METRICS[metric].is_share else (0, None)))
    axes.set_xlabel(f"{METRICS[metric].label} ({unit_of(metric, task)})")


def _quiet_rows(axes: Axes, runs: int) -> None:
    """Leave only what a row of dots needs; the runs' names, which come first, in full ink."""
    axes.grid(axis="x")
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)
    for label in axes.get_yticklabels()[:runs]:
        label.set_color(INK)


def _histogram(axes: Axes, episodes: Sequence[EpisodeMetrics]) -> None:
    """Stack the episodes' lengths by outcome."""
    longest = max([STEP_LIMIT, *(episode.steps for episode in episodes)])
    # One bar more than the limit: an episode of 200 steps gets its own, not that of 190-199.
    edges = np.arange(0, longest + 2 * BIN, BIN)
    bottom, weight = np.zeros(len(edges) - 1), 100 / max(1, len(episodes))
    for outcome in Outcome:
        steps = [episode.steps for episode in episodes if episode.outcome is outcome]
        counts = np.histogram(steps, edges)[0] * weight
        if counts.any():
            colour = OUTCOMES[outcome]
            axes.bar(edges[:-1], counts, BIN * 0.88, bottom, align="edge", color=colour)
            bottom += counts
    axes.set_xlim(0, edges[-1])
    # A stacked bar's foot holds the axis at its height; without this the tallest has no air.
    axes.use_sticky_edges = False
    axes.autoscale_view(scalex=False)
    axes.set_ylim(bottom=0)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=4, integer=True))
    axes.grid(axis="y")


def _touch_curve(axes: Axes, summary: TaskSummary, colour: str) -> None:
    """Draw one curve, faint where few episodes are left."""
    steps = np.arange(len(summary.touch_curve))
    curve = np.asarray(summary.touch_curve)
    axes.plot(steps, curve, color=colour, lw=1.1, alpha=0.35)
    reached = np.asarray(summary.touch_curve_episodes)
    if reached.size == curve.size:
        axes.plot(steps, np.where(reached >= FEW * reached[0], curve, np.nan), color=colour, lw=1.6)


def _short(name: str) -> str:
    """Return a name that fits beside a plot."""
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 1]}…"


def _svg(figure: Figure, description: str) -> str:
    """Write a figure as an SVG element that scales and takes the page's colours and font."""
    text = io.StringIO()
    with warnings.catch_warnings():
        # A name may hold any character; the page's font draws it, not matplotlib's.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    drawing = text.getvalue()
    drawing = drawing[drawing.index("<svg") :]
    # A style element inside the drawing would reach the whole page.
    drawing = re.sub(r"<(metadata|style)\b.*?</\1>", "", drawing, flags=re.DOTALL)
    # Groups are named alike in every figure; only what is referred to keeps its name.
    referred = set(re.findall(r'(?:url\(#|href="#)([^)"]+)', drawing))
    drawing = re.sub(
        r' id="([^"]+)"', lambda found: found[0] if found[1] in referred else "", drawing
    )
    drawing = re.sub(r"font-family: [^;\"]+", "font-family: inherit", drawing)
    drawing = re.sub(r"(font: [\d.]+px) [^;\"]+", r"\1 inherit", drawing)
    for sentinel, css in _CSS.items():
        drawing = drawing.replace(sentinel, css)
    label = f'role="img" aria-label="{html.escape(description)}"'
    return re.sub(r' width="[^"]+" height="[^"]+"', f" {label}", drawing, count=1).strip()
