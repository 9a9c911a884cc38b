"""A study's report: Table 4 over training seeds, learning curves, and the order of the methods."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import PROGRESS_FILE, RUN_FILE, write_file
from minitouch_bench.metrics.definitions import METRICS, metrics_shown_in
from minitouch_bench.metrics.intervals import bootstrap_mean
from minitouch_bench.metrics.metric import ShownIn
from minitouch_bench.protocol.minitouch import MAIN_SUITE, NOVEL_SHAPES
from minitouch_bench.records import Estimate, SavedRun, Summary
from minitouch_bench.rendering import latex
from minitouch_bench.rendering.figure_files import write_figures
from minitouch_bench.rendering.markdown import escape, table_lines
from minitouch_bench.rendering.pages import render_page
from minitouch_bench.rendering.tables import (
    ABSENT,
    Cell,
    Column,
    Row,
    Table,
    difference_cell,
    estimate_cell,
    metric_head,
)
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.reporting.over_runs import OVER_SEEDS
from minitouch_bench.reporting.paper import PAPER_METHODS, PAPER_NOTE, paper_cell
from minitouch_bench.reporting.run_directory import read_run
from minitouch_bench.reporting.study_figures import (
    EXPLORING,
    GAP,
    HELD_OUT,
    MOVEMENT,
    TOUCH,
    TRAIN,
    study_estimate,
    study_figures,
)
from minitouch_bench.reporting.study_orders import episode_values, judge_orders, orders_table
from minitouch_bench.reporting.training_page import episode_success

TEMPLATE = Path(__file__).parent / "templates" / "study.html.j2"
TIME_NOTE = "Time: of the training alone, without its evaluation, beside whatever else ran."
EPISODES_ONLY = "one training seed: its interval is over episodes only"


@dataclass(frozen=True)
class StudyTraining:
    """One cell of a study's grid."""

    task: str
    method: str
    seed: int
    exploration_steps: int

    @property
    def name(self) -> str:
        """Its directory in the study's."""
        return f"{self.task}-{self.method}-{self.exploration_steps}-{self.seed}"


PROGRESS_TYPES: Final = {
    "step": "int64", "episodes": "int64", "success": "float64", "touch_share": "float64",
    "seconds": "float64",
}  # fmt: skip
FIELDS = tuple(StudyTraining.__dataclass_fields__)
"""The columns that name a training."""


@dataclass(frozen=True)
class StudyResults:
    """Which trainings of a study are done, which failed and why, and which are left."""

    directory: Path
    done: tuple[StudyTraining, ...]
    failed: Mapping[StudyTraining, str]
    left: tuple[StudyTraining, ...]


def write_study(results: StudyResults) -> None:
    """Write ``estimates.csv``, ``curves.csv``, ``orders.csv``, figures, ``tables.tex``, report.

    Raises:
        RunDirectoryError: a file cannot be read or written.
    """
    runs = _runs(results)
    estimates, curves = _estimates(runs), _curves(results)
    directory = results.directory
    write_file(directory / "estimates.csv", estimates.to_csv(index=False))
    write_file(directory / "curves.csv", curves.to_csv(index=False))
    orders = judge_orders(_episode_values(runs))
    write_file(directory / "orders.csv", orders.to_csv(index=False))
    tables = (*_tables(estimates), *((orders_table(orders),) if len(orders) else ()))
    trainings = trainings_table(results)
    figures = tuple(study_figures(estimates, curves))
    write_figures(figures, directory / "figures")
    sources = [latex.table_source(table, table.title) for table in tables]
    write_file(directory / "tables.tex", "\n".join(sources))
    write_file(directory / "report.md", _markdown(results, (*tables, trainings)))
    page = render_page(
        TEMPLATE, name=directory.resolve().name, tables=tables, figures=figures,
        trainings=trainings, state=state_lines(results)[0],
    )  # fmt: skip
    write_file(directory / "report.html", page)


def _runs(results: StudyResults) -> list[tuple[StudyTraining, SavedRun]]:
    """Read the evaluations of each training, one per suite."""
    return [
        (training, read_run(file.parent))
        for training in results.done
        for file in sorted((results.directory / training.name).glob(f"*/{RUN_FILE}"))
    ]


def _estimates(runs: Sequence[tuple[StudyTraining, SavedRun]]) -> pd.DataFrame:
    """Return a row per training, suite, and metric of its evaluation."""
    rows = []
    for training, run in runs:
        (summary,) = run.summary.tasks
        found = [
            *summary.estimates.items(),
            *_on_both_splits(run.summary),
            *_while_exploring(run),
        ]
        head = (*vars(training).values(), run.header.suite)
        rows += [(*head, metric, e.value, e.low, e.high, e.count) for metric, e in found]
    columns = [*FIELDS, "suite", "metric", "value", "low", "high", "episodes"]
    return pd.DataFrame(rows, columns=columns)


def _episode_values(runs: Sequence[tuple[StudyTraining, SavedRun]]) -> pd.DataFrame:
    """Return a row per training, metric and episode of the main suite, for ``judge_orders``."""
    rows = [
        (*vars(training).values(), *one)
        for training, run in runs
        if run.header.suite == MAIN_SUITE
        for one in episode_values(run)
    ]
    return pd.DataFrame(rows, columns=[*FIELDS, "metric", "episode", "value"])


def _on_both_splits(summary: Summary) -> Iterator[tuple[str, Estimate]]:
    for part in summary.generalization:
        for metric, gap in part.gaps.items():
            yield f"{metric}{GAP}", gap.difference
            yield f"{metric}{HELD_OUT}", gap.held_out
            yield f"{metric}{TRAIN}", gap.train


def _while_exploring(run: SavedRun) -> Iterator[tuple[str, Estimate]]:
    """Yield what Figure 9 shows, of the policy as it stood at the end of exploration."""
    for metric in (MOVEMENT, TOUCH):
        values = METRICS[metric].values(run.exploration_episodes)
        if values:
            found = bootstrap_mean(np.array(values), np.random.default_rng(0))
            yield f"{metric}{EXPLORING}", found


def _curves(results: StudyResults) -> pd.DataFrame:
    """Return a row per training and line of its ``progress.csv``; those under way, too."""
    frames = []
    for training in (*results.done, *results.failed, *results.left):
        rows = _progress(results.directory, training)
        if not rows.empty:
            kept = rows[["step", "touch_share"]].assign(success=episode_success(rows))
            frames.append(kept.assign(**vars(training)))
    columns = [*FIELDS, "step", "touch_share", "success"]
    return pd.concat(frames)[columns] if frames else pd.DataFrame(columns=columns)


def _tables(estimates: pd.DataFrame) -> Iterator[Table]:
    """Yield Table 4 for each length of exploration, then the gaps on novel shapes."""
    for suite, title in ((MAIN_SUITE, "Table 4"), (NOVEL_SHAPES, "Novel shapes")):
        own = estimates[estimates["suite"] == suite]
        for steps, part in own.groupby("exploration_steps", sort=True):
            yield _table(f"{title}, {steps:,} steps of exploration", suite, part)


def _table(title: str, suite: str, part: pd.DataFrame) -> Table:
    methods = tuple(dict.fromkeys(part["method"]))
    with_paper = suite == MAIN_SUITE
    columns: list[Column] = []
    cells: list[tuple[str, str, str]] = []
    for task in dict.fromkeys(part["task"]):
        group = task_title(task)
        columns += [Column(method, group) for method in methods]
        cells += [(task, method, "") for method in methods]
        if with_paper:
            columns += [Column(method, group, is_paper=True) for method in PAPER_METHODS]
            cells += [(task, "", method) for method in PAPER_METHODS]
    metrics = (
        metrics_shown_in(ShownIn.TABLE4)
        if with_paper
        else tuple(name for name in dict.fromkeys(part["metric"]) if name.endswith(GAP))
    )
    rows = []
    for metric in metrics:
        shown = metric.split(",")[0]
        row = tuple(
            paper_cell(task, metric, paper) if paper else _cell(part, task, method, metric)
            for task, method, paper in cells
        )
        if all(cell.text == ABSENT for cell in row):
            continue
        head = metric_head(shown) + metric.removeprefix(shown)
        rows.append(Row((head,), row, METRICS[shown].unit))
    notes = (
        f"95 % intervals: {OVER_SEEDS}: of few seeds too narrow, as it never "
        f"goes beyond their range; {EPISODES_ONLY}.",
        *((PAPER_NOTE,) * with_paper),
    )
    return Table(title, ("Metric",), tuple(columns), tuple(rows), notes)


def _cell(part: pd.DataFrame, task: str, method: str, metric: str) -> Cell:
    own = part[(part["task"] == task) & (part["method"] == method) & (part["metric"] == metric)]
    shown, found = metric.split(",", maxsplit=1)[0], study_estimate(own)
    if found is not None and metric.endswith(GAP):
        return difference_cell(shown, found)
    return estimate_cell(shown, found)


def state_lines(results: StudyResults) -> list[str]:
    """Say in a line each how far a study is, and which trainings failed."""
    number = len(results.done) + len(results.failed) + len(results.left)
    return [
        f"{len(results.done)} of {number} trainings are done and evaluated{_time_left(results)}",
        *(f"{training.name} failed: {why}" for training, why in results.failed.items()),
    ]


def _time_left(results: StudyResults) -> str:
    """Say how long the rest will take, by the trainings that are done, without evaluations."""
    if not results.done or not results.left:
        return ""
    seconds = [last_progress(results.directory, training)[1] for training in results.done]
    hours = float(np.mean(seconds)) * len(results.left) / 3600
    return f"; those left train for about {hours:.1f} hours, one at a time"


def last_progress(directory: Path, training: StudyTraining) -> tuple[int, float]:
    """Return how many control steps a training has done, and in how many seconds.

    Raises:
        RunDirectoryError: its ``progress.csv`` cannot be read.
    """
    rows = _progress(directory, training)
    if rows.empty:
        return 0, 0.0
    return int(rows["step"].iloc[-1]), float(rows["seconds"].iloc[-1])


def _progress(directory: Path, training: StudyTraining) -> pd.DataFrame:
    """Return what a report needs of a training's ``progress.csv``, (rows, ``PROGRESS_TYPES``)."""
    file = directory / training.name / PROGRESS_FILE
    try:
        whole, _, _torn = file.read_text(encoding="utf-8").rpartition("\n")
        return pd.read_csv(StringIO(whole), usecols=[*PROGRESS_TYPES], dtype=PROGRESS_TYPES)
    except (FileNotFoundError, pd.errors.EmptyDataError):  # no row yet
        return pd.DataFrame(columns=[*PROGRESS_TYPES])
    except (OSError, ValueError) as error:
        raise RunDirectoryError(f"{file} cannot be read: {error}") from error


def trainings_table(results: StudyResults) -> Table:
    """Return a row per training: its state, its control steps, and the time it took."""
    states = {
        **{training: f"failed: {why}" for training, why in results.failed.items()},
        **dict.fromkeys(results.left, ""),
        **dict.fromkeys(results.done, "done"),
    }
    rows = []
    for training, state in states.items():
        steps, seconds = last_progress(results.directory, training)
        cells = (
            Cell(state or ("under way" if steps else "waiting")),
            Cell(f"{steps:,}"),
            Cell(f"{seconds / 60:.1f} min"),
        )
        rows.append(Row((training.name,), cells))
    columns = (Column("State", is_text=True), Column("Control steps"), Column("Time"))
    return Table("Trainings", ("Training",), columns, tuple(rows), (TIME_NOTE,))


def _markdown(results: StudyResults, tables: Sequence[Table]) -> str:
    parts = [f"# Study {escape(results.directory.resolve().name)}", ""]
    parts += [f"- {escape(line)}" for line in state_lines(results)]
    for table in tables:
        parts += ["", f"## {table.title}", "", *table_lines(table), ""]
        parts += [f"- {escape(note)}" for note in table.notes]
    return "\n".join(parts) + "\n"
