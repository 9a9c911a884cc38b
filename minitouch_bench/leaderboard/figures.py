"""The figures of the board and of a submission's page."""

import math
from collections.abc import Sequence

import numpy as np

from minitouch_bench.leaderboard.board import Board, BoardRow
from minitouch_bench.leaderboard.entries import ENDING_TONES, ENDINGS, Entry, endings
from minitouch_bench.leaderboard.scores import MEAN_SUCCESS, OVERALL
from minitouch_bench.leaderboard.submission import BOARD_GOALS, BOARD_TASKS, MAIN_SUITE
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import Role
from minitouch_bench.rendering.charts import (
    Axis,
    Chart,
    Dot,
    Figure,
    Line,
    Mark,
    Plot,
    Tick,
    share_axis,
    step_histograms,
    touch_chart,
)
from minitouch_bench.reporting.labels import task_title

FEW_POINTS = 60
"""Submissions up to which names and intervals are drawn; more would be a wall of lines."""


def submission_figures(entry: Entry) -> tuple[Figure, ...]:
    """Return how long a submission's episodes last, and its touch over time."""
    several = "; a line per training seed" if len(entry.seeds) > 1 else ""
    return (
        Figure(
            "episode-steps",
            "How long episodes last",
            "Share of the episodes by number of control steps, and by how they ended.",
            tuple(_steps_plot(entry, task) for task in BOARD_GOALS),
        ),
        Figure(
            "touch-over-time",
            "Touch over time",
            "Mean ticks in contact at each control step, over the episodes that reached "
            f"it{several}.",
            tuple(_touch_plot(entry, task) for task in BOARD_TASKS),
        ),
    )


def efficiency_plot(board: Board) -> Plot | None:
    """Draw mean success against training steps on a logarithmic axis.

    Rows without training are left out; None where that leaves none.
    """
    trained = [row for row in board.ranked if row.about.training_steps > 0]
    if not trained:
        return None
    powers = [math.log10(row.about.training_steps) for row in trained]
    first = math.floor(min(powers))
    last = max(math.ceil(max(powers)), first + 1)
    ticks = tuple(Tick(power, amount(10**power)) for power in range(first, last + 1))
    axis = Axis("Control steps of the whole training", first, last, ticks)
    few = len(trained) <= FEW_POINTS
    marks = [
        mark
        for power, row in zip(powers, trained, strict=True)
        for mark in _efficiency_marks(power, row, few)
    ]
    chart = Chart(axis, share_axis("Mean success"), tuple(marks), 270)
    return Plot("", "Mean success against training steps", (chart,))


def amount(number: int) -> str:
    """Write a large number short: 2 M, 1.5 k; one that is not exact with three digits."""
    for size, unit in ((10**12, "T"), (10**9, "G"), (10**6, "M"), (10**3, "k")):
        if number >= size:
            return f"{number / size:.3g}\u202f{unit}"
    return str(number) if number else "none"


def _efficiency_marks(power: float, row: BoardRow, few: bool) -> list[Mark]:
    found = row.scored.figures[OVERALL][MEAN_SUCCESS]
    name, steps = row.name, amount(row.about.training_steps)
    dot = Dot(
        power,
        found.value,
        "series-0",
        size=10 if few else 6,
        label=name if few else "",
        link=f"submission/{name}.html",
        title=f"{name}: {found.value:.3f} after {steps} control steps",
    )
    interval = Line(((power, found.low), (power, found.high)), "series-0", 1.5, 0.45)
    return [interval, dot] if few else [dot]


def _steps_plot(entry: Entry, task: str) -> Plot:
    listed = entry.episodes(MAIN_SUITE, Role.FINAL, task)
    steps = np.concatenate([episodes.values["episode_steps"] for episodes in listed])
    ended = np.concatenate([endings(episodes, task) for episodes in listed])
    panel = {ENDING_TONES[ending]: steps[ended == index] for index, ending in enumerate(ENDINGS)}
    title = task_title(task)
    what = f"{title}: episodes by control steps and ending"
    return Plot(title, what, step_histograms({"": panel}, PROTOCOL.task(task).max_steps))


def _touch_plot(entry: Entry, task: str) -> Plot:
    runs = [seed.runs[MAIN_SUITE] for seed in entry.seeds]
    curves: list[tuple[Sequence[float], Sequence[int]]] = [
        (run.touch_curves.get(task, ()), ()) for run in runs
    ]
    title = task_title(task)
    what = f"{title}: mean contact ticks at each control step"
    return Plot(title, what, (touch_chart(curves, PROTOCOL.task(task).max_steps),))
