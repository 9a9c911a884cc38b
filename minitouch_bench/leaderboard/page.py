"""The page of one submission."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup

from minitouch_bench.episode import Episode, Role
from minitouch_bench.errors import printable
from minitouch_bench.files import VIDEOS
from minitouch_bench.leaderboard.board import (
    COLUMN_SPECS,
    TOUCH_METRICS,
    BoardRow,
    Ending,
    ending_of,
)
from minitouch_bench.leaderboard.proof import MEANINGS, ProofLevel
from minitouch_bench.leaderboard.ranking import OVERALL, RANKED_BY, Rank
from minitouch_bench.leaderboard.submission import BOARD_GOALS, BOARD_TASKS
from minitouch_bench.leaderboard.validation import SubmissionFindings
from minitouch_bench.leaderboard.views import EPISODE_VARIANCE, SEED_VARIANCE, with_learned
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.protocol.minitouch import MAIN_SUITE, PROTOCOL
from minitouch_bench.reporting.charts import Figure, LegendItem, Plot
from minitouch_bench.reporting.figures import steps_plot, touch_plot
from minitouch_bench.reporting.labels import group_faults, task_title
from minitouch_bench.reporting.pages import render_page
from minitouch_bench.reporting.report import Video
from minitouch_bench.reporting.run_tables import gap_cells
from minitouch_bench.reporting.svg import draw_share_bar
from minitouch_bench.reporting.tables import (
    Row,
    Table,
    estimate_cell,
    make_columns,
    make_row,
    metric_head,
)
from minitouch_bench.reporting.writers import Card, make_card
from minitouch_bench.runs.results import TABLE4_METRICS
from minitouch_bench.runs.run import Run

TEMPLATES = Path(__file__).parent / "templates"
STYLES = ("board.css",)


def submission_page(verdict: SubmissionFindings, row: BoardRow, ranked: int) -> str:
    """Write the page of a submission, whose row is among so many ``ranked`` ones."""
    path = f"{verdict.directory.resolve().parent.name}/{row.name}"
    ranks = {key: _rank_text(rank) for key, rank in row.ranks.items()}
    return render_page(
        TEMPLATES / "submission.html.j2",
        STYLES,
        ("theme.js", "submission.js"),
        protocol=PROTOCOL.name,
        row=row,
        facts=COLUMN_SPECS,
        seeds=verdict.submission.seeds,
        runs=verdict.runs,
        path=path,
        rank=f"{ranks[OVERALL]} of {ranked}" if ranks else "",
        level=list(ProofLevel).index(row.proof),
        meaning=MEANINGS[row.proof],
        cards=tuple(_card(row, task, ranks.get(task, "")) for task in BOARD_TASKS),
        legend=tuple(_legend(row)),
        bars=tuple((task_title(task), _ending_bar(row, task)) for task in BOARD_TASKS),
        values=_values(row),
        gaps=_gaps(row) if row.novel_shapes else None,
        figures=submission_figures(verdict),
        data=_data(verdict, path),
        videos=[
            Video(Path(video).stem.replace("-", " "), video_address(row.name, video))
            for video in verdict.videos()
        ],
        faults=_faults(verdict),
    )


def video_address(name: str, path: str) -> str:
    """Return where a submission's video lies beside its page."""
    # The parts were checked: seed, suite, "videos", and a plain name.
    return f"{name}/{path.replace(f'/{VIDEOS}/', '-').replace('/', '-')}"


def _rank_text(rank: Rank) -> str:
    return f"rank {rank.best} to {rank.worst}" if rank.worst > rank.best else f"rank {rank.best}"


def _card(row: BoardRow, task: str, rank: str) -> Card:
    card = make_card(task, [(row.name, row.figures[task])], f"../pictures/{task}.png", rank)
    values = (replace(one, cell=with_learned(one.cell, row, task)) for one in card.values)
    return replace(card, values=tuple(values))


def _legend(row: BoardRow) -> Iterator[LegendItem]:
    there = {ending for counts in row.endings.values() for ending in counts}
    for ending in Ending:
        if ending in there:
            yield LegendItem(ending.value, ending.tone, title=ending.meaning)


def _ending_bar(row: BoardRow, task: str) -> Markup:
    counts = row.endings[task]
    text = ", ".join(f"{ending} {count}" for ending, count in counts.items())
    parts = [(ending.tone, ending.value, counts.get(ending, 0)) for ending in Ending]
    return draw_share_bar(parts, f"{task_title(task)}: {text}")


def _values(row: BoardRow) -> Table:
    several = len(row.training_seeds) > 1
    learned = (row.learned_in(task).removesuffix(" seeds learned") for task in BOARD_TASKS)
    note = SEED_VARIANCE if several else f"{EPISODE_VARIANCE[0].upper()}{EPISODE_VARIANCE[1:]}."
    return Table(
        title="All values",
        corner=("Metric", "Unit"),
        columns=make_columns(*map(task_title, BOARD_TASKS)),
        rows=tuple(
            Row(
                (metric_head(metric), METRICS[metric].unit),
                tuple(estimate_cell(metric, row.estimate(task, metric)) for task in BOARD_TASKS),
            )
            for metric in (*TABLE4_METRICS, *TOUCH_METRICS)
        )
        + ((make_row(("Learned", "seeds"), *learned),) if several else ()),
        notes=(f"Brackets: 95 % interval. {note}",),
    )


def _gaps(row: BoardRow) -> Table:
    return Table(
        title="Novel shapes",
        corner=("Task", "Metric"),
        columns=make_columns("Held-out", "Train", "Gap", "Verdict", words=("Verdict",)),
        rows=tuple(
            Row(
                (task_title(task), METRICS[RANKED_BY[task]].label),
                gap_cells(task, RANKED_BY[task], gap),
            )
            for task, gap in row.novel_shapes.items()
        ),
    )


def _data(verdict: SubmissionFindings, path: str) -> Markup:
    """Write the episodes as JSON that no reader of HTML takes for markup."""
    document = {
        "endings": [ending.value for ending in Ending],
        "tones": [ending.tone for ending in Ending],
        "runs": [
            {
                "title": folder,
                "command": f"minitouch-bench replay {path}/{folder} EPISODE --video VIDEO",
                "groups": list(_groups(run)),
            }
            for folder, run in verdict.runs.items()
        ],
    }
    return htmlsafe_json_dumps(document, separators=(",", ":"), allow_nan=False)


def _groups(run: Run) -> Iterator[dict[str, Any]]:
    """Yield the episodes of each role and task, a list per column."""
    numbers = {ending: number for number, ending in enumerate(Ending)}
    for role, rows in run.by_role():
        for task in dict.fromkeys(row.task for row in rows):
            episodes = [row for row in rows if row.task == task]
            shapes = [printable(row.shape) for row in episodes]
            yield {
                "key": task if role is Role.FINAL else f"exploration/{task}",
                "index": [row.index for row in episodes],
                "ending": [numbers[ending_of(row)] for row in episodes],
                "steps": [row.steps for row in episodes],
                "touch": [row.touch_interaction for row in episodes],
                "first": [_seconds(row) for row in episodes],
                "shapes": shapes if len(set(shapes)) > 1 else None,
            }


def _seconds(episode: Episode) -> float | None:
    """Return the time of the first touch in few digits, None where there is none."""
    tick = episode.first_touch_tick
    return None if tick is None else round(tick / PROTOCOL.physics.tick_rate, 3)


def _faults(verdict: SubmissionFindings) -> Mapping[str, Sequence[str]]:
    """Return each fault's text with its episodes, which a run names where there are several."""
    runs = verdict.runs
    return group_faults(
        (f"{folder} {key}" if len(runs) > 1 else key, text)
        for folder, run in runs.items()
        for key, text in run.faults.items()
    )


def submission_figures(verdict: SubmissionFindings) -> tuple[Figure, ...]:
    """Return how long a submission's episodes last, and its touch over time."""
    several = "; a line per training seed" if len(verdict.submission.seeds) > 1 else ""
    return (
        Figure(
            "episode-steps",
            "How long episodes last",
            "Share of the episodes by number of control steps, and by how they ended.",
            tuple(_steps_plot(verdict, task) for task in BOARD_GOALS),
        ),
        Figure(
            "touch-over-time",
            "Touch over time",
            "Mean ticks in contact at each control step, over the episodes that reached it; "
            f"faint where fewer than a tenth are left{several}.",
            tuple(touch_plot(task, verdict.runs_on(MAIN_SUITE)) for task in BOARD_TASKS),
        ),
    )


def _steps_plot(verdict: SubmissionFindings, task: str) -> Plot:
    panel: dict[str, list[int]] = {ending.tone: [] for ending in Ending}
    for episode in chain(*verdict.episodes(task)):
        panel[ending_of(episode).tone].append(episode.steps)
    return steps_plot(task, {"": {tone: np.array(steps) for tone, steps in panel.items()}})
