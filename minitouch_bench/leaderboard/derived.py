"""What follows from a run's episodes, computed anew and compared: estimates, tables, actions."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.documents import plain
from minitouch_bench.evaluation.actions import read_actions
from minitouch_bench.files import ACTIONS_FILE
from minitouch_bench.leaderboard.inventory import RUN_LIMITS, read_plain
from minitouch_bench.metrics import summarize_episodes
from minitouch_bench.records import EpisodeMetrics, EpisodeSpec, SavedRun, TaskSummary
from minitouch_bench.reporting import derived_files
from minitouch_bench.verification.problems import ROUNDING, Problem, Problems, compare_values
from minitouch_bench.verification.recorded_run import AS_WRITTEN, NAMED

CURVE_TOLERANCE = 1e-6
"""Relative rounding of a sum over a touch curve's means."""


def check_estimates(saved: SavedRun, place: str, problems: Problems) -> None:
    """Compute every estimate from the episodes, with the run's own random stream."""
    rng = np.random.default_rng(saved.header.seed)
    found = summarize_episodes(saved.header.tasks, saved.episodes, saved.exploration_episodes, rng)
    recorded = replace(
        saved.summary, tasks=tuple(_without_curve(task) for task in saved.summary.tasks)
    )
    differences = compare_values("summary", plain(recorded), plain(found), ROUNDING)
    for difference in _first(differences):
        problems.add_below(place, replace(difference, remedy=AS_WRITTEN))
    for task in saved.summary.tasks:
        if what := _curve_at_fault(task, [e for e in saved.episodes if e.task == task.task]):
            problems.add(f"{place}, touch curve of {task.task}", what, AS_WRITTEN)


def check_tables(directory: Path, place: str, saved: SavedRun, problems: Problems) -> None:
    """Hold the CSV files and ``report.md`` against those that ``run.json`` gives, byte for byte."""
    expected = derived_files(saved, directory / place)
    for name, text in expected.items():
        if not (directory / place / name).exists():
            problems.add(f"{place}/{name}", "it is missing", AS_WRITTEN)
            continue
        with problems.caught(f"{place}/{name}"):
            if read_plain(directory, f"{place}/{name}", RUN_LIMITS[name]) != text.encode():
                problems.add(f"{place}/{name}", "it is not what run.json gives", AS_WRITTEN)
    for name in RUN_LIMITS:
        extra = name.endswith((".csv", ".md")) and name not in expected
        if extra and (directory / place / name).exists():
            problems.add(f"{place}/{name}", "run.json gives no such file", "remove it")


def check_actions(directory: Path, place: str, saved: SavedRun, problems: Problems) -> None:
    """Check that every episode has its actions, as many as it has steps, within -1 to 1."""
    rows = dict(_rows_by_spec(saved))
    with problems.caught(f"{place}/{ACTIONS_FILE}", AS_WRITTEN):
        actions = read_actions(directory / place, list(rows))
        missing = [spec.key for spec in rows if spec.key not in actions]
        if missing:
            problems.add(
                f"{place}/{ACTIONS_FILE}",
                f"the actions of {len(missing)} episodes are missing: {', '.join(missing[:NAMED])}",
                AS_WRITTEN,
            )
        for spec, row in rows.items():
            if spec.key in actions and (what := _actions_at_fault(actions[spec.key], row)):
                problems.add(f"{place}/{ACTIONS_FILE}, {spec.key}", what, AS_WRITTEN)


def _rows_by_spec(saved: SavedRun) -> Iterator[tuple[EpisodeSpec, EpisodeMetrics]]:
    """Walk through the rows of both roles with what they are called in ``actions.npz``."""
    for role, rows in saved.by_role():
        for row in rows:
            yield EpisodeSpec(role, row.task, row.index, row.seed), row


def _actions_at_fault(actions: NDArray[np.float32], row: EpisodeMetrics) -> str:
    """Return what is wrong with an episode's actions, "" if nothing."""
    if len(actions) != row.steps:
        return f"{len(actions)} actions, the episode has {row.steps} steps"
    # The recorded actions are as applied: a clipped one stands at a bound.
    at_bounds = int((np.abs(actions) == 1).any(axis=1).sum())
    if row.clipped_actions > at_bounds:
        return f"{row.clipped_actions} are said to be clipped, {at_bounds} are at a bound"
    return ""


def _curve_at_fault(task: TaskSummary, episodes: list[EpisodeMetrics]) -> str:
    """Return what is wrong with a touch curve, as far as rows can tell, "" if nothing."""
    steps = np.array([episode.steps for episode in episodes], np.int64)
    longest = int(steps.max(initial=0))
    reached = [int((steps > step).sum()) for step in range(longest)]
    if list(task.touch_curve_episodes) != reached or len(task.touch_curve) != longest:
        return "it is not over the episodes that reached each step"
    total = float(np.dot(task.touch_curve, reached)) if reached else 0.0
    expected = sum(episode.touch_interaction for episode in episodes)
    if abs(total - expected) > CURVE_TOLERANCE * max(1, expected):
        return f"it adds up to {total:.0f} ticks, the episodes to {expected}"
    return ""


def _without_curve(task: TaskSummary) -> TaskSummary:
    return replace(task, touch_curve=(), touch_curve_episodes=())


def _first(differences: Iterator[Problem]) -> Iterator[Problem]:
    """Yield a few differences: one edited figure shows in several places."""
    for difference, _ in zip(differences, range(2 * NAMED), strict=False):
        yield difference
