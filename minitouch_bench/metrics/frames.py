"""Episodes and estimates as data frames, and what a notebook shows of them."""

import html
from collections.abc import Iterable, Sequence

import pandas as pd

from minitouch_bench.episode import Episode
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.summary import (
    EPISODE_COLUMNS,
    TABLE4_METRICS,
    Summary,
    TaskResult,
    episode_row,
)
from minitouch_bench.text import printable

_BESIDE = ("family", "split", "digest")
_STARTS = (
    *("start_x", "start_y", "start_z", "start_yaw", "target_x", "target_y"),
    *("end_effector_x", "end_effector_y", "end_effector_z"),
)
"""What a frame of episodes has and ``episodes.csv`` has not; see ``episode.Start``."""
OFTEN_MISSING = ("time_to_first_touch", "peak_force", "contact_force")
"""Columns without a value where nothing was touched."""


def estimates_frame(result: TaskResult) -> pd.DataFrame:
    """Return a row per metric: label, unit, value, low and high (95 %), count, method."""
    rows = {
        name: {"label": METRICS[name].label, "unit": METRICS[name].unit_in(result.task)}
        | vars(estimate)
        for name, estimate in result.estimates.items()
    }
    return pd.DataFrame.from_dict(rows, orient="index")


def episodes_frame(episodes: Iterable[Episode]) -> pd.DataFrame:
    """Return a row per episode: EPISODE_COLUMNS, family, split, digest, and where it began.

    What an episode does not have, such as the time of its first touch, is NaN.
    """
    rows = []
    for episode in episodes:
        start = episode.start
        target = start.target or (None, None)
        places = (*start.position, start.yaw, *target, *start.end_effector)
        beside = (getattr(episode, name) for name in _BESIDE)
        rows.append((*episode_row(episode), *beside, *places))
    frame = pd.DataFrame(rows, columns=[*EPISODE_COLUMNS, *_BESIDE, *_STARTS])
    frame["outcome"] = frame["outcome"].map(str)  # plain words, not members of the enumeration
    numbers = dict.fromkeys((*OFTEN_MISSING, *_STARTS), "float64")
    return frame.astype({"outcome": "str", **numbers})


def table4_frame(summary: Summary) -> pd.DataFrame:
    """Return Table 4 in the paper's shape: metrics as rows, tasks as groups of columns.

    Each task has the columns ``value``, ``low`` and ``high`` (95 %), NaN without estimate.
    """
    columns = {}
    for part in summary.tasks:
        found = [part.estimates.get(name) for name in TABLE4_METRICS]
        for end in ("value", "low", "high"):
            values = [getattr(one, end) if one else float("nan") for one in found]
            columns[part.task, end] = values
    return pd.DataFrame(columns, pd.Index(TABLE4_METRICS, name="metric"))


def results_html(
    title: str, results: Sequence[TaskResult], metrics: Iterable[str] = TABLE4_METRICS
) -> str:
    """Write what a notebook shows of results: metrics down, tasks across, outcomes below."""
    rows, names = {}, [result.task for result in results]
    alone = names[0] if len(names) == 1 else ""
    for name in metrics:
        metric, found = METRICS[name], [result.estimates.get(name) for result in results]
        if any(found):
            texts = (f"{one:{metric.number_format}}" if one else "—" for one in found)
            head = f"{metric.label} {metric.direction_in(alone)}".rstrip()
            rows[head] = [metric.unit_in(alone), *texts]
    ended = (
        ", ".join(f"{how.replace('_', ' ')} {n}" for how, n in result.outcomes.items() if n)
        for result in results
    )
    rows["Outcomes"] = ["episodes", *ended]
    columns = ["unit", *(["value"] if alone else names)]
    frame = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
    head, note = html.escape(printable(title)), "Brackets: 95 % interval over episodes."
    with pd.option_context("display.max_colwidth", None):  # nothing is cut
        table = frame.to_html(border=0)
    return f"<p><b>{head}</b></p>{table}<p><small>{note}</small></p>"
