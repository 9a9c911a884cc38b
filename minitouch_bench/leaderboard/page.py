"""What stands on the page of one submission."""

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from minitouch_bench.files import VIDEOS
from minitouch_bench.leaderboard.board import TOUCH_METRICS, BoardRow
from minitouch_bench.leaderboard.entries import (
    ENDING_MEANINGS,
    ENDING_TONES,
    ENDINGS,
    Entry,
    RunData,
    endings,
)
from minitouch_bench.leaderboard.proof import MEANINGS as PROOF_MEANINGS
from minitouch_bench.leaderboard.proof import RANKED_LEVELS, ProofLevel
from minitouch_bench.leaderboard.ranking import Rank
from minitouch_bench.leaderboard.scores import OVERALL, RANKED_BY, ScoredSubmission
from minitouch_bench.leaderboard.submission import BOARD_GOALS, BOARD_TASKS, MAIN_SUITE
from minitouch_bench.leaderboard.views import EPISODE_VARIANCE
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.protocol.minitouch import PROTOCOL
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
TWINS = "twins"
MARK = re.compile("\x00([^\x00]*)\x00")
"""What stands in a page in place of a text, with its key; no printable text holds it."""


def submission_page(entry: Entry, scored: ScoredSubmission) -> str:
    """Write the page of a submission, with marks where its ranks and its twins stand.

    Those depend on the other submissions; ``finish_page`` fills them in.
    """
    path = f"{entry.directory.resolve().parent.name}/{scored.name}"
    several = len(entry.seeds) > 1
    is_ranked = scored.level in RANKED_LEVELS and not scored.is_calibration
    return render_page(
        TEMPLATES / "submission.html.j2",
        STYLES,
        ("theme.js", "submission.js"),
        protocol=PROTOCOL.name,
        entry=entry,
        about=scored.about,
        path=path,
        rank=_mark(OVERALL) if is_ranked else "",
        twins=_mark(TWINS),
        level=list(ProofLevel).index(entry.level),
        meaning=PROOF_MEANINGS[entry.level],
        modalities=", ".join(scored.about.modalities) or "sees nothing",
        training_steps=amount(scored.about.training_steps),
        seeds_in_words=f"{len(entry.seeds)} training seeds" if several else "one training seed",
        cards=tuple(_card(scored, task, _mark(task) if is_ranked else "") for task in BOARD_TASKS),
        legend=tuple(_legend(scored)),
        bars=tuple((task_title(task), _ending_bar(scored, task)) for task in BOARD_TASKS),
        values=_values(scored),
        gaps=_gaps(scored) if scored.gaps else None,
        figures=submission_figures(entry),
        data=Markup(_data(entry, path)),
        videos=tuple(Video(caption, address) for address, caption in video_names(scored)),
        faults=_faults(entry),
    )


def finish_page(row: BoardRow, ranked: int) -> str:
    """Return a row's page with its ranks among ``ranked`` rows, and its twins."""
    texts = {key: _rank_text(rank) for key, rank in row.ranks.items()}
    if texts:
        texts[OVERALL] += f" of {ranked}"
    texts[TWINS] = f" It repeats others: {row.repeats}." if row.repeats else ""
    return MARK.sub(lambda found: str(escape(texts.get(found[1], ""))), row.scored.page)


def video_names(scored: ScoredSubmission) -> Iterator[tuple[str, str]]:
    """Yield where each video lies beside the page, and its caption."""
    for path in scored.videos:
        # The parts were checked: seed, suite, "videos", and a plain name.
        name = path.replace(f"/{VIDEOS}/", "-").replace("/", "-")
        yield f"{scored.name}/{name}", Path(name).stem.replace("-", " ")


def _mark(key: str) -> str:
    return f"\x00{key}\x00"


def _rank_text(rank: Rank) -> str:
    """Write a rank with the range that holds the true one."""
    return f"rank {rank.best} to {rank.worst}" if rank.worst > rank.best else f"rank {rank.best}"


def _card(scored: ScoredSubmission, task: str, rank: str) -> Card:
    runs = [(scored.name, scored.figures[task])]
    return make_card(task, runs, f"../pictures/{task}.png", rank)


def _legend(scored: ScoredSubmission) -> Iterator[LegendItem]:
    """Name the endings that occur."""
    there = {ending for counts in scored.endings.values() for ending in counts}
    for ending in ENDINGS:
        if ending in there:
            yield LegendItem(ending.value, ENDING_TONES[ending], title=ENDING_MEANINGS[ending])


def _ending_bar(scored: ScoredSubmission, task: str) -> Markup:
    counts = scored.endings[task]
    said = ", ".join(f"{ending} {count}" for ending, count in counts.items())
    parts = [(ENDING_TONES[ending], ending.value, counts.get(ending, 0)) for ending in ENDINGS]
    return draw_share_bar(parts, f"{task_title(task)}: {said}")


def _values(scored: ScoredSubmission) -> Table:
    variance = "Bootstrap over training seeds" if len(scored.about.seeds) > 1 else EPISODE_VARIANCE
    return Table(
        title="All values",
        corner=("Metric", "Unit"),
        columns=tuple(Column(task_title(task)) for task in BOARD_TASKS),
        rows=tuple(
            Row(
                (metric_head(metric), METRICS[metric].unit),
                tuple(estimate_cell(metric, scored.estimate(task, metric)) for task in BOARD_TASKS),
            )
            for metric in (*TABLE4_METRICS, *TOUCH_METRICS)
        ),
        notes=(f"Brackets: 95 % interval. {variance[0].upper()}{variance[1:]}.",),
    )


def _gaps(scored: ScoredSubmission) -> Table:
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
            for task, gap in scored.gaps.items()
        ),
    )


def _data(entry: Entry, path: str) -> str:
    """Write the episodes as JSON that no reader of HTML takes for markup."""
    runs = [
        {
            "title": run.place,
            "command": f"minitouch-bench replay {path}/{run.place} EPISODE --film FILM",
            "groups": list(_groups(run)),
        }
        for seed in entry.seeds
        for run in seed.runs.values()
    ]
    document = {
        "endings": [ending.value for ending in ENDINGS],
        "tones": [ENDING_TONES[ending] for ending in ENDINGS],
        "runs": runs,
    }
    text = json.dumps(document, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _groups(run: RunData) -> Iterator[dict[str, Any]]:
    """Yield the episodes of each task and role, a list per column."""
    for (role, task), episodes in run.episodes.items():
        first = [
            None if math.isnan(value) else _seconds(value)
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


def _seconds(value: float) -> float:
    """Round a time to that of its tick, in few digits."""
    rate = PROTOCOL.physics.tick_rate
    return round(round(value * rate) / rate, 3)


def _faults(entry: Entry) -> Mapping[str, Sequence[str]]:
    """Return each fault's text with its episodes, which a run names where there are several."""
    runs = [run for seed in entry.seeds for run in seed.runs.values()]
    return group_faults(
        (f"{run.place} {key}" if len(runs) > 1 else key, text)
        for run in runs
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
    runs = [seed.runs[MAIN_SUITE] for seed in entry.seeds]
    curves: list[tuple[Sequence[float], Sequence[int]]] = [
        (run.touch_curves.get(task, ()), ()) for run in runs
    ]
    title = task_title(task)
    what = f"{title}: mean contact ticks at each control step"
    return Plot(title, what, (touch_chart(curves, PROTOCOL.task(task).max_steps),))
