"""The plots of a board's pages as inline SVG.

Written directly: matplotlib takes some 80 ms a plot, and a board of a thousand submissions has
ten thousand. They carry classes and attributes only, no styles, so that the pages' policy can
forbid every style but their own.
"""

import html
import math
from collections.abc import Mapping, Sequence

import numpy as np

from minitouch_bench.leaderboard.entries import Episodes
from minitouch_bench.leaderboard.failures import ENDINGS, Ending, endings

WIDTH, HEIGHT = 340, 190
LEFT, RIGHT, TOP, BOTTOM = 42, 8, 10, 40
STEP_LIMIT = 200
STEP_TICKS = (0, 50, 100, 150, 200)
BIN = 10
"""Control steps in one bar of the distribution of episode steps."""

BAR_WIDTH, BAR_HEIGHT = 600, 26
LEAST_NAMED = 0.05
"""Share of a bar below which its count does not fit."""

SCATTER_WIDTH, SCATTER_HEIGHT = 1124, 330
MAX_WHISKERS = 60
"""Points up to which intervals are drawn; more would be a wall of lines."""


def ending_bar(counts: Mapping[Ending, int], title: str) -> str:
    """Draw how episodes ended as one bar from 0 to 100 %."""
    total = sum(counts.values())
    parts, x = [], 0.0
    for place, ending in enumerate(ENDINGS):
        count = counts.get(ending, 0)
        width = BAR_WIDTH * count / total
        if count:
            parts.append(
                f'<rect class="area ending-{place}" x="{x:.1f}" y="0" height="16" rx="2" '
                f'width="{max(width - 1.5, 0.5):.1f}">'
                f"<title>{ending}: {count} of {total}</title></rect>"
            )
            if count >= LEAST_NAMED * total:
                parts.append(f'<text x="{x + 1:.1f}" y="26">{count}</text>')
        x += width
    said = ", ".join(f"{ending} {count}" for ending, count in counts.items())
    return _svg(BAR_WIDTH, BAR_HEIGHT, f"{title}: {said}", parts)


def steps_plot(listed: Sequence[Episodes], task: str, title: str) -> str:
    """Draw what share of the episodes took how many control steps, stacked by ending."""
    steps = np.concatenate([episodes.values["episode_steps"] for episodes in listed])
    ends = np.concatenate([endings(episodes, task) for episodes in listed])
    edges = np.arange(0, STEP_LIMIT + 2 * BIN, BIN)
    counts = np.array([np.histogram(steps[ends == k], edges)[0] for k in range(len(ENDINGS))])
    shares = 100 * counts / max(1, steps.size)
    top = _nice(float(shares.sum(axis=0).max()))
    x = _Scale(0, float(edges[-1]), LEFT, WIDTH - RIGHT)
    y = _Scale(0, top, HEIGHT - BOTTOM, TOP)
    parts = _frame(x, y, top, "Episodes, %")
    floor = np.zeros(shares.shape[1])
    for place, own in enumerate(shares):
        for slot in np.flatnonzero(own):
            low, high = y(floor[slot]), y(floor[slot] + own[slot])
            parts.append(
                f'<rect class="area ending-{place}" x="{x(edges[slot]) + 0.7:.1f}" y="{high:.1f}" '
                f'width="{x(BIN) - x(0) - 1.4:.1f}" height="{low - high:.1f}"/>'
            )
        floor += own
    return _svg(WIDTH, HEIGHT, f"{title}: episodes by control steps and ending", parts)


def touch_plot(curves: Sequence[Sequence[float]], title: str) -> str:
    """Draw the mean contact ticks at each control step, a line a training seed."""
    top = _nice(max((max(curve, default=0.0) for curve in curves), default=0.0))
    x = _Scale(0, STEP_LIMIT, LEFT, WIDTH - RIGHT)
    y = _Scale(0, top, HEIGHT - BOTTOM, TOP)
    parts = _frame(x, y, top, "Contact, ticks a step")
    for place, curve in enumerate(curves):
        points = " ".join(f"{x(step):.1f},{y(value):.1f}" for step, value in enumerate(curve))
        parts.append(f'<polyline class="line series-{place % 6}" points="{points}"/>')
    return _svg(WIDTH, HEIGHT, f"{title}: mean contact ticks at each control step", parts)


def efficiency_plot(points: Sequence[tuple[str, int, float, float, float]]) -> str:
    """Draw score (value, low, high) against training steps on a logarithmic axis, "" for none.

    ``points``: name, steps, value, low, high; those without training are left out.
    """
    trained = [point for point in points if point[1] > 0]
    if not trained:
        return ""
    logs = [math.log10(point[1]) for point in trained]
    first, last = math.floor(min(logs)), max(math.ceil(max(logs)), math.floor(min(logs)) + 1)
    x = _Scale(first, last, LEFT, SCATTER_WIDTH - 130)
    y = _Scale(0, 1, SCATTER_HEIGHT - BOTTOM, TOP)
    parts = _rules(y, 1.0, SCATTER_WIDTH - RIGHT)
    for power in range(first, last + 1):
        parts.append(
            f'<text x="{x(power):.1f}" y="{SCATTER_HEIGHT - BOTTOM + 18}" '
            f'text-anchor="middle">{amount(10**power)}</text>'
        )
    parts.append(
        f'<text x="{(x(first) + x(last)) / 2:.1f}" y="{SCATTER_HEIGHT - 4}" text-anchor="middle">'
        "Control steps of the whole training</text>"
    )
    few = len(trained) <= MAX_WHISKERS
    for log, (name, steps, value, low, high) in zip(logs, trained, strict=True):
        at, safe = x(log), html.escape(name)
        mark = f'<circle class="dot" cx="{at:.1f}" cy="{y(value):.1f}" r="{5 if few else 3}"/>'
        whisker = label = ""
        if few:
            whisker = f'<path class="whisker" d="M{at:.1f} {y(low):.1f}V{y(high):.1f}"/>'
            label = f'<text class="name" x="{at + 10:.1f}" y="{y(value) + 4:.1f}">{safe}</text>'
        parts.append(
            f'<a class="series-0" href="submission/{safe}.html">{whisker}{mark}{label}'
            f"<title>{safe}: {value:.3f} after {amount(steps)} control steps</title></a>"
        )
    return _svg(SCATTER_WIDTH, SCATTER_HEIGHT, "Mean success against training steps", parts)


def amount(number: int) -> str:
    """Write a large number short: 2 M, 1.5 k; one that is not exact with three digits."""
    for size, unit in ((10**12, "T"), (10**9, "G"), (10**6, "M"), (10**3, "k")):
        if number >= size:
            return f"{number / size:.3g}\u202f{unit}"
    return str(number) if number else "none"


class _Scale:
    """A linear axis."""

    def __init__(self, low: float, high: float, start: float, end: float) -> None:
        self._low, self._start = low, start
        self._factor = (end - start) / (high - low)

    def __call__(self, value: float) -> float:
        return float(self._start + (value - self._low) * self._factor)


def _frame(x: _Scale, y: _Scale, top: float, up: str) -> list[str]:
    """Draw rules, numbers and labels of a plot over control steps."""
    parts = _rules(y, top, WIDTH - RIGHT)
    parts += [
        f'<text x="{x(tick):.1f}" y="{HEIGHT - BOTTOM + 15}" text-anchor="middle">{tick}</text>'
        for tick in STEP_TICKS
    ]
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(
        f'<text x="{middle:.0f}" y="{HEIGHT - 6}" text-anchor="middle">Control steps</text>'
    )
    centre = (TOP + HEIGHT - BOTTOM) / 2
    parts.append(
        f'<text transform="translate(10 {centre:.0f}) rotate(-90)" text-anchor="middle">{up}</text>'
    )
    return parts


def _rules(y: _Scale, top: float, end: float) -> list[str]:
    parts = []
    for step in range(5):
        value = top * step / 4
        at = y(value)
        kind = "axis" if step == 0 else "rule"
        parts.append(f'<path class="{kind}" d="M{LEFT} {at:.1f}H{end}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{at + 4:.1f}" text-anchor="end">{value:g}</text>')
    return parts


def _nice(value: float) -> float:
    """Return a round number that is no smaller and divides by four."""
    if value <= 0:
        return 4.0
    size = 10.0 ** math.floor(math.log10(value))
    return float(next(step * size for step in (1, 2, 4, 6, 8, 10, 20) if step * size >= value))


def _svg(width: int, height: int, label: str, parts: Sequence[str]) -> str:
    return (
        f'<svg class="drawing" viewBox="0 0 {width} {height}" role="img" '
        f'aria-label="{html.escape(label)}">{"".join(parts)}</svg>'
    )
