"""What stands on the page of one submission."""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from minitouch_bench.leaderboard.board import TOUCH_METRICS, Row
from minitouch_bench.leaderboard.drawings import ending_bar, steps_plot, touch_plot
from minitouch_bench.leaderboard.entries import Entry, RunData
from minitouch_bench.leaderboard.failures import ENDINGS, MEANINGS, endings
from minitouch_bench.leaderboard.proof import MEANINGS as PROOF_MEANINGS
from minitouch_bench.leaderboard.proof import ProofLevel
from minitouch_bench.leaderboard.ranking import RANKED_BY, Rank
from minitouch_bench.leaderboard.scores import OVERALL
from minitouch_bench.leaderboard.submission import MAIN_SUITE
from minitouch_bench.leaderboard.views import EPISODE_VARIANCE, Figure, figure, gap_figures
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL
from minitouch_bench.records import Role
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.tables import metric_head
from minitouch_bench.reporting.cards import BESIDE_SUCCESS, BESIDE_TOUCH
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.novel_shapes import verdict
from minitouch_bench.reporting.paper import PAPER_METHODS, PAPER_TASKS, paper_value
from minitouch_bench.reporting.tables import TABLE4_METRICS

HEADROOM = 1.1
"""A gauge without a natural end reaches a tenth beyond the largest figure on it."""


@dataclass(frozen=True)
class Card:
    """One task's verdict. ``gauge``: value, low, high and the paper's mark, in percent."""

    task: str
    title: str
    metric: str
    figure: Figure
    gauge: tuple[float, float, float, float | None]
    paper: str
    beside: tuple[tuple[str, str], ...]
    rank: Rank | None


def page_context(row: Row, ranked: int) -> dict[str, Any]:
    """Return the variables of a submission's page; ``ranked`` is the number of ranked rows."""
    entry = row.entry
    place = f"{entry.directory.resolve().parent.name}/{entry.name}"
    several = len(entry.seeds) > 1
    return {
        "entry": entry,
        "place": place,
        "rank": row.ranks.get(OVERALL),
        "ranked": ranked,
        "level": list(ProofLevel).index(entry.level),
        "meaning": PROOF_MEANINGS[entry.level],
        "twins": row.twins,
        "modalities": ", ".join(entry.about.modalities) or "sees nothing",
        "seeds_in_words": f"{len(entry.seeds)} training seeds" if several else "one training seed",
        "variance": "Bootstrap over training seeds" if several else EPISODE_VARIANCE.capitalize(),
        "cards": tuple(_card(row, task) for task in PAPER_TASKS),
        "legend": _legend(row),
        "bars": _bars(row),
        "tasks": tuple(map(task_title, PAPER_TASKS)),
        "figures": tuple(_figures(row)),
        "gaps": tuple(_gaps(row)),
        "plots": _plots(entry),
        "data": Markup(_data(entry, place)),
        "faults": _faults(entry),
    }


def _card(row: Row, task: str) -> Card:
    metric = RANKED_BY[task]
    estimate = row.figures[task, metric]
    printed = paper_value(task, metric, PAPER_METHODS[0])
    paper = printed.number if printed else None
    end = 1.0 if METRICS[metric].is_share else HEADROOM * max(estimate.high, paper or 0.0, 1.0)
    places = [
        round(100 * value / end, 2) for value in (estimate.value, estimate.low, estimate.high)
    ]
    beside = BESIDE_SUCCESS if task in GOAL_TASKS else BESIDE_TOUCH
    figures = [(METRICS[m].label, _beside(row, task, m)) for m in beside]
    return Card(
        task=task,
        title=task_title(task),
        metric=f"{METRICS[metric].label}, {METRICS[metric].unit}",
        figure=figure(metric, estimate),
        gauge=(
            places[0],
            places[1],
            places[2],
            None if paper is None else round(100 * paper / end, 2),
        ),
        paper=f"{PAPER_METHODS[0]} in the paper: {printed.text}" if printed else "",
        beside=tuple(figures),
        rank=row.ranks.get(task),
    )


def _beside(row: Row, task: str, metric: str) -> str:
    estimate = row.estimate(task, metric)
    unit = " s" if estimate and METRICS[metric].unit == "s" else ""
    return figure(metric, estimate).text + unit


def _legend(row: Row) -> tuple[tuple[int, str, str], ...]:
    """Return the endings that occur, with their place among the colours."""
    there = {ending for counts in row.endings.values() for ending in counts}
    return tuple(
        (place, ending.value, MEANINGS[ending])
        for place, ending in enumerate(ENDINGS)
        if ending in there
    )


def _bars(row: Row) -> tuple[tuple[str, Markup], ...]:
    return tuple(
        (task_title(task), Markup(ending_bar(row.endings[task], task_title(task))))
        for task in PAPER_TASKS
    )


def _figures(row: Row) -> Iterator[tuple[str, str, list[Figure]]]:
    """Yield label, unit and cells of each metric."""
    for metric in (*TABLE4_METRICS, *TOUCH_METRICS):
        cells = [figure(metric, row.estimate(task, metric)) for task in PAPER_TASKS]
        yield metric_head(metric), METRICS[metric].unit, cells


def _gaps(row: Row) -> Iterator[tuple[str, str, list[Figure], str]]:
    for task, gap in row.gaps.items():
        metric = RANKED_BY[task]
        cells = list(gap_figures(metric, gap))
        yield task_title(task), METRICS[metric].label, cells, verdict(task, metric, gap.difference)


def _plots(entry: Entry) -> tuple[tuple[str, str, tuple[tuple[str, Markup], ...]], ...]:
    goals = [task for task in PAPER_TASKS if task in GOAL_TASKS]
    steps = tuple(
        (
            task_title(task),
            Markup(
                steps_plot(entry.episodes(MAIN_SUITE, Role.FINAL, task), task, task_title(task))
            ),
        )
        for task in goals
    )
    runs = [seed.runs[MAIN_SUITE] for seed in entry.seeds]
    touch = tuple(
        (
            task_title(task),
            Markup(touch_plot([run.touch_curves.get(task, ()) for run in runs], task_title(task))),
        )
        for task in PAPER_TASKS
    )
    lines = "; a line a training seed" if len(runs) > 1 else ""
    return (
        (
            "How long episodes last",
            "Share of the episodes by number of control steps, and by how they ended.",
            steps,
        ),
        (
            "Touch over time",
            "Mean ticks in contact at each control step, over the episodes that reached "
            f"it{lines}.",
            touch,
        ),
    )


def _data(entry: Entry, place: str) -> str:
    """Write the episodes as JSON that no reader of HTML takes for markup."""
    runs = [
        {
            "title": run.place,
            "command": f"minitouch-bench replay {place}/{run.place} EPISODE --film FILM",
            "groups": list(_groups(run)),
        }
        for seed in entry.seeds
        for run in seed.runs.values()
    ]
    document = {"endings": [ending.value for ending in ENDINGS], "runs": runs}
    text = json.dumps(document, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _groups(run: RunData) -> Iterator[dict[str, Any]]:
    """Yield the episodes of each task and role, a list a column."""
    for (role, task), episodes in run.episodes.items():
        first = [
            None if math.isnan(value) else _ticks(value)
            for value in episodes.values["time_to_first_touch"]
        ]
        yield {
            "key": task if role is Role.FINAL else f"exploration/{task}",
            "index": episodes.index.tolist(),
            "ending": endings(episodes, task).tolist(),
            "steps": _whole(episodes.values["episode_steps"]),
            "touch": _whole(episodes.values["touch_interaction"]),
            "first": first,
            "shapes": [printable(shape) for shape in episodes.shapes]
            if len(set(episodes.shapes)) > 1
            else None,
        }


def _whole(counts: NDArray[np.float64]) -> list[int]:
    return [int(count) for count in counts]


def _ticks(seconds: float) -> float:
    return round(round(seconds * PROTOCOL.physics.tick_rate) / PROTOCOL.physics.tick_rate, 3)


def _faults(entry: Entry) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return each fault's text with its episodes, equal ones once."""
    found: dict[str, list[str]] = {}
    several = len(entry.seeds) > 1
    for seed in entry.seeds:
        for run in seed.runs.values():
            for key, text in run.faults.items():
                name = f"{run.place} {key}" if several else key
                found.setdefault(printable(text), []).append(printable(name))
    return tuple((text, tuple(keys)) for text, keys in found.items())
