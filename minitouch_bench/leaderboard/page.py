"""What stands on the page of one submission."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup, escape
from numpy.typing import NDArray

from minitouch_bench.files import VIDEOS
from minitouch_bench.leaderboard.board import TOUCH_METRICS, BoardRow, ScoredSubmission
from minitouch_bench.leaderboard.entries import (
    ENDING_MEANINGS,
    ENDING_TONES,
    ENDINGS,
    Entry,
    Episodes,
    endings,
)
from minitouch_bench.leaderboard.proof import MEANINGS as PROOF_MEANINGS
from minitouch_bench.leaderboard.proof import ProofLevel
from minitouch_bench.leaderboard.ranking import Rank
from minitouch_bench.leaderboard.scores import OVERALL, RANKED_BY
from minitouch_bench.leaderboard.submission import BOARD_GOALS, BOARD_TASKS
from minitouch_bench.leaderboard.views import EPISODE_VARIANCE
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.protocol.minitouch import MAIN_SUITE, PROTOCOL
from minitouch_bench.records import Role
from minitouch_bench.rendering.charts import Figure, LegendItem, Plot, step_histograms, touch_chart
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.pages import render_page
from minitouch_bench.rendering.svg import draw_share_bar
from minitouch_bench.rendering.tables import Column, Row, Table, estimate_cell, metric_head
from minitouch_bench.reporting.labels import group_faults, task_title
from minitouch_bench.reporting.report import Video
from minitouch_bench.reporting.tables import TABLE4_METRICS, gap_cells
from minitouch_bench.reporting.writers import Card, make_card

TEMPLATES = Path(__file__).parent / "templates"
STYLES = ("board.css",)
COPIES = "copies"
MARK = re.compile("\x00([^\x00]*)\x00")
"""What stands in a page in place of a text, with its key; no printable text holds it."""


def submission_page(entry: Entry, scored: ScoredSubmission) -> str:
    """Write the page of a submission, with marks where its ranks and its copies stand.

    Those depend on the other submissions; ``finish_page`` fills them in.
    """
    row = scored.row
    path = f"{entry.verdict.directory.resolve().parent.name}/{row.name}"
    several = len(row.training_seeds) > 1
    return render_page(
        TEMPLATES / "submission.html.j2",
        STYLES,
        ("theme.js", "submission.js"),
        protocol=PROTOCOL.name,
        row=row,
        seeds=entry.seeds,
        runs=entry.verdict.runs,
        path=path,
        rank=_mark(OVERALL) if row.is_ranked else "",
        copies=_mark(COPIES),
        level=list(ProofLevel).index(row.proof),
        meaning=PROOF_MEANINGS[row.proof],
        modalities=", ".join(row.modalities) or "sees nothing",
        training_steps=amount(row.training_steps),
        seeds_in_words=f"{len(entry.seeds)} training seeds" if several else "one training seed",
        cards=tuple(_card(row, task, _mark(task) if row.is_ranked else "") for task in BOARD_TASKS),
        legend=tuple(_legend(row)),
        bars=tuple((task_title(task), _ending_bar(row, task)) for task in BOARD_TASKS),
        values=_values(row),
        gaps=_gaps(row) if row.novel_shapes else None,
        figures=submission_figures(entry),
        data=_data(entry, path),
        videos=[
            Video(Path(video).stem.replace("-", " "), video_address(row.name, video))
            for video in scored.videos
        ],
        faults=_faults(entry),
    )


def finish_page(page: str, row: BoardRow, ranked: int) -> str:
    """Return a submission's page with its ranks among ``ranked`` rows, and its copies."""
    texts = {key: _rank_text(rank) for key, rank in row.ranks.items()}
    if texts:
        texts[OVERALL] += f" of {ranked}"
    texts[COPIES] = f" It repeats others: {row.repeats}." if row.repeats else ""
    return MARK.sub(lambda found: str(escape(texts.get(found[1], ""))), page)


def video_address(name: str, path: str) -> str:
    """Return where a submission's video lies beside its page."""
    # The parts were checked: seed, suite, "videos", and a plain name.
    return f"{name}/{path.replace(f'/{VIDEOS}/', '-').replace('/', '-')}"


def _mark(key: str) -> str:
    return f"\x00{key}\x00"


def _rank_text(rank: Rank) -> str:
    """Write a rank with the range that holds the true one."""
    return f"rank {rank.best} to {rank.worst}" if rank.worst > rank.best else f"rank {rank.best}"


def _card(row: BoardRow, task: str, rank: str) -> Card:
    runs = [(row.name, row.figures[task])]
    return make_card(task, runs, f"../pictures/{task}.png", rank)


def _legend(row: BoardRow) -> Iterator[LegendItem]:
    """Name the endings that occur."""
    there = {ending for counts in row.endings.values() for ending in counts}
    for ending in ENDINGS:
        if ending in there:
            yield LegendItem(ending.value, ENDING_TONES[ending], title=ENDING_MEANINGS[ending])


def _ending_bar(row: BoardRow, task: str) -> Markup:
    counts = row.endings[task]
    said = ", ".join(f"{ending} {count}" for ending, count in counts.items())
    parts = [(ENDING_TONES[ending], ending.value, counts.get(ending, 0)) for ending in ENDINGS]
    return draw_share_bar(parts, f"{task_title(task)}: {said}")


def _values(row: BoardRow) -> Table:
    variance = "Bootstrap over training seeds" if len(row.training_seeds) > 1 else EPISODE_VARIANCE
    return Table(
        title="All values",
        corner=("Metric", "Unit"),
        columns=tuple(Column(task_title(task)) for task in BOARD_TASKS),
        rows=tuple(
            Row(
                (metric_head(metric), METRICS[metric].unit),
                tuple(estimate_cell(metric, row.estimate(task, metric)) for task in BOARD_TASKS),
            )
            for metric in (*TABLE4_METRICS, *TOUCH_METRICS)
        ),
        notes=(f"Brackets: 95 % interval. {variance[0].upper()}{variance[1:]}.",),
    )


def _gaps(row: BoardRow) -> Table:
    return Table(
        title="Novel shapes",
        corner=("Task", "Metric"),
        columns=(
            *map(Column, ("Held-out", "Train", "Gap")),
            Column("Verdict", is_text=True),
        ),
        rows=tuple(
            Row(
                (task_title(task), METRICS[RANKED_BY[task]].label),
                gap_cells(task, RANKED_BY[task], gap),
            )
            for task, gap in row.novel_shapes.items()
        ),
    )


def _data(entry: Entry, path: str) -> Markup:
    """Write the episodes as JSON that no reader of HTML takes for markup."""
    runs = [
        {
            "title": place,
            "command": f"minitouch-bench replay {path}/{place} EPISODE --film FILM",
            "groups": [
                _group(role, task, episodes)
                for (own, role, task), episodes in entry.columns.items()
                if own == place
            ],
        }
        for place in entry.verdict.runs
    ]
    document = {
        "endings": [ending.value for ending in ENDINGS],
        "tones": [ENDING_TONES[ending] for ending in ENDINGS],
        "runs": runs,
    }
    return htmlsafe_json_dumps(document, separators=(",", ":"), allow_nan=False)


def _group(role: Role, task: str, episodes: Episodes) -> dict[str, Any]:
    """Return the episodes of a task and a role, a list per column."""
    first = episodes.values["time_to_first_touch"]
    return {
        "key": task if role is Role.FINAL else f"exploration/{task}",
        "index": episodes.index.tolist(),
        "ending": endings(episodes, task).tolist(),
        "steps": _whole(episodes.values["episode_steps"]),
        "touch": _whole(episodes.values["touch_interaction"]),
        "first": [None if math.isnan(value) else _seconds(value) for value in first],
        "shapes": [printable(shape) for shape in episodes.shapes]
        if len(set(episodes.shapes)) > 1
        else None,
    }


def _whole(counts: NDArray[np.float64]) -> list[int]:
    return [int(count) for count in counts]


def _seconds(value: float) -> float:
    """Round a time to that of its tick, in few digits."""
    rate = PROTOCOL.physics.tick_rate
    return round(round(value * rate) / rate, 3)


def _faults(entry: Entry) -> Mapping[str, Sequence[str]]:
    """Return each fault's text with its episodes, which a run names where there are several."""
    runs = entry.verdict.runs
    return group_faults(
        (f"{place} {key}" if len(runs) > 1 else key, text)
        for place, run in runs.items()
        for key, text in run.faults.items()
    )


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


def amount(number: int) -> str:
    """Write a large number short: 2 M, 1.5 k; one that is not exact with three digits."""
    for size, unit in ((10**12, "T"), (10**9, "G"), (10**6, "M"), (10**3, "k")):
        if number >= size:
            return f"{number / size:.3g}\u202f{unit}"
    return str(number) if number else "none"


def _steps_plot(entry: Entry, task: str) -> Plot:
    listed = entry.episodes(MAIN_SUITE, Role.FINAL, task)
    steps = np.concatenate([episodes.values["episode_steps"] for episodes in listed])
    ended = np.concatenate([endings(episodes, task) for episodes in listed])
    panel = {ENDING_TONES[ending]: steps[ended == index] for index, ending in enumerate(ENDINGS)}
    title = task_title(task)
    what = f"{title}: episodes by control steps and ending"
    return Plot(title, what, step_histograms({"": panel}, PROTOCOL.task(task).max_steps))


def _touch_plot(entry: Entry, task: str) -> Plot:
    runs = [entry.verdict.runs[seed.runs[MAIN_SUITE]] for seed in entry.seeds]
    curves: list[tuple[Sequence[float], Sequence[int]]] = [
        (own.touch_curve, ()) for run in runs for own in run.summary.tasks if own.task == task
    ]
    title = task_title(task)
    what = f"{title}: mean contact ticks at each control step"
    return Plot(title, what, (touch_chart(curves, PROTOCOL.task(task).max_steps),))
