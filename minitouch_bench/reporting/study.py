"""A study's report: claims, Table 4 over training seeds, and learning curves."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from minitouch_bench.conditions import STANDARD
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import PROGRESS_FILE, write_file
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import bootstrap_mean
from minitouch_bench.metrics.summary import compare_episodes
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.records import Estimate
from minitouch_bench.rendering import latex
from minitouch_bench.rendering.figure_files import write_figures
from minitouch_bench.rendering.markdown import escape, table_section
from minitouch_bench.rendering.pages import render_page
from minitouch_bench.rendering.tables import Table, make_columns, make_row
from minitouch_bench.reporting import long_frame
from minitouch_bench.reporting.claims import (
    Claim,
    JudgedClaim,
    claims_frame,
    claims_table,
    judge_claims,
)
from minitouch_bench.reporting.study_figures import EXPLORING, MOVEMENT, TOUCH, study_figures
from minitouch_bench.reporting.study_tables import study_tables
from minitouch_bench.reporting.training_page import episode_success
from minitouch_bench.runs.run import Run

TEMPLATE = Path(__file__).parent / "templates" / "study.html.j2"
TIME_NOTE = "Time: of the training alone, without its evaluation, beside whatever else ran."


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
HEAD: Final = ("task", "method", "seed", "steps")
"""The columns that name a training."""
RENAMED: Final = {"steps": "exploration_steps", "count": "episodes"}
"""Columns in the files, where they have another name than in the frames."""
ESTIMATES: Final = (*HEAD, "suite", "conditions", "metric", "value", "low", "high", "count")


@dataclass(frozen=True)
class StudyResults:
    """Which trainings of a study are done, which failed and why, and which are left.

    ``untrained``: those left that have no policy yet; the others are to be evaluated. ``runs``:
    those that there are of what the study's file asks for.
    """

    directory: Path
    done: tuple[StudyTraining, ...]
    failed: Mapping[StudyTraining, str]
    left: tuple[StudyTraining, ...]
    untrained: tuple[StudyTraining, ...]
    runs: Mapping[StudyTraining, tuple[Run, ...]]
    claims: tuple[Claim, ...] = ()

    @property
    def trainings(self) -> tuple[StudyTraining, ...]:
        """All of them: those that are done, those that failed, those that are left."""
        return *self.done, *self.failed, *self.left


def write_study(results: StudyResults) -> None:
    """Write ``estimates.csv``, ``curves.csv``, ``claims.csv``, figures, ``tables.tex``, report.

    Raises:
        RunDirectoryError: a file cannot be read or written.
    """
    rows = (
        row
        for training, runs in results.runs.items()
        for run in runs
        for row in _rows(training, run, runs)
    )
    estimates, curves = long_frame.make_long_frame(rows), _curves(results)
    judged = _judge(results, estimates)
    directory = results.directory
    for name, frame in (
        ("estimates.csv", estimates[[*ESTIMATES]]),
        ("curves.csv", curves),
        ("claims.csv", claims_frame(judged)),
    ):
        write_file(directory / name, frame.rename(columns=RENAMED).to_csv(index=False))
    tables = (*((claims_table(judged),) if judged else ()), *study_tables(estimates))
    trainings = trainings_table(results)
    figures = study_figures(estimates, curves)
    write_figures(figures, directory / "figures")
    sources = [latex.table_source(table, table.title) for table in tables]
    write_file(directory / "tables.tex", "\n".join(sources))
    write_file(directory / "report.md", _markdown(results, (*tables, trainings)))
    page = render_page(
        TEMPLATE, name=directory.resolve().name, tables=tables, figures=figures,
        trainings=trainings, state=state_lines(results)[0],
    )  # fmt: skip
    write_file(directory / "report.html", page)


def _rows(training: StudyTraining, run: Run, runs: Sequence[Run]) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of a run, and what Figure 9 shows of the policy at the end of exploration.

    Of a run under other conditions also what they change. The steps of the frame are those of
    exploration.
    """
    label = long_frame.RunLabel(training.method, training.seed, training.exploration_steps)
    yield from long_frame.frame_rows(label, run)
    for metric in (MOVEMENT, TOUCH):
        if values := METRICS[metric].values(run.exploration_episodes):
            estimate = bootstrap_mean(values, np.random.default_rng(0))
            yield long_frame.frame_row(label, run, training.task, metric + EXPLORING, estimate)
    for other in runs if run.plan.conditions != STANDARD else ():
        if (other.plan.suite, other.plan.conditions) == (run.plan.suite, STANDARD):
            metric, change = _change(training.task, run, other)
            yield long_frame.frame_row(label, run, training.task, metric, change)


def _change(task: str, run: Run, standard: Run) -> tuple[str, Estimate]:
    """Return what ranks the task, less its value in the same episodes of the standard run."""
    metric = METRICS[ranking_metric(task)]
    both = {row.index for row in run.episodes} & {row.index for row in standard.episodes}
    first, second = ([row for row in one.episodes if row.index in both] for one in (run, standard))
    change = compare_episodes(task, metric, first, second, (run.plan.seed,)).difference
    return metric.name + long_frame.CHANGE, change


def _judge(results: StudyResults, estimates: pd.DataFrame) -> list[JudgedClaim]:
    """Judge the claims, each at the longest exploration of its tasks."""
    longest: dict[str, int] = {}
    for one in results.trainings:
        longest[one.task] = max(one.exploration_steps, longest.get(one.task, 0))
    main = long_frame.select(estimates, suite=MAIN_SUITE, conditions="")
    values = main[main["steps"] == main["task"].map(longest)]
    names = values[["task", "method", "seed", "metric"]]
    measured = {*names.itertuples(index=False, name=None)}
    waiting = [
        claim
        for claim in results.claims
        for one in results.trainings
        if (one.task, one.method) in claim.trained
        and (one.task, one.method, one.seed, claim.metric) not in measured
    ]
    return judge_claims(results.claims, values, waiting)


def _curves(results: StudyResults) -> pd.DataFrame:
    """Return a row per training and line of its ``progress.csv``; those under way, too."""
    columns = [*HEAD, "step", "touch_share", "success"]
    frames = []
    for training in results.trainings:
        rows = _progress(results.directory, training)
        if not rows.empty:
            named = dict(zip(HEAD, vars(training).values(), strict=True))
            frames.append(rows.assign(success=episode_success(rows), **named)[columns])
    return pd.concat(frames) if frames else pd.DataFrame(columns=columns)


def state_lines(results: StudyResults) -> list[str]:
    """Say in a line each how far a study is, and which trainings failed."""
    done, number = len(results.done), len(results.trainings)
    return [
        f"{done} of {number} trainings are done and evaluated{_time_left(results)}",
        *(f"{training.name} failed: {why}" for training, why in results.failed.items()),
    ]


def _time_left(results: StudyResults) -> str:
    """Say how long the rest will take, without evaluations.

    A training takes the mean of those of its task that are done, of all where there is none.
    """
    if not results.done or not results.untrained:
        return ""
    seconds = {one: last_progress(results.directory, one)[1] for one in results.done}
    of_task = {
        task: float(np.mean([taken for one, taken in seconds.items() if one.task == task]))
        for task in {one.task for one in seconds}
    }
    usual = float(np.mean([*seconds.values()]))
    minutes = sum(of_task.get(one.task, usual) for one in results.untrained) / 60
    time = f"{minutes:.0f} minutes" if minutes < 120 else f"{minutes / 60:.0f} hours"
    return f"; those left train for about {time}, one at a time"


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
    for training, known in states.items():
        steps, seconds = last_progress(results.directory, training)
        begun = "evaluated in part" if results.runs.get(training) else "under way"
        state = known or (begun if steps else "waiting")
        rows.append(make_row(training.name, state, f"{steps:,}", f"{seconds / 60:.1f} min"))
    columns = make_columns("State", "Control steps", "Time", words=["State"])
    return Table("Trainings", ("Training",), columns, tuple(rows), (TIME_NOTE,))


def _markdown(results: StudyResults, tables: Sequence[Table]) -> str:
    parts = [f"# Study {escape(results.directory.resolve().name)}", ""]
    parts += [f"- {escape(line)}" for line in state_lines(results)]
    parts += [line for table in tables for line in table_section(table)]
    return "\n".join(parts) + "\n"
