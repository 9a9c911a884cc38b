"""A study: a grid of trainings, each evaluated under the protocol, as a queue that can be resumed.

The files say what is done, so a killed study continues where it was.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from minitouch_bench.agents.config import (
    CONFIG_FILE,
    TrainingConfig,
    apply_settings,
    make_config,
    read_config,
)
from minitouch_bench.documents import read_json, read_toml, take_table, write_json
from minitouch_bench.errors import MiniTouchError, RunDirectoryError, UsageError
from minitouch_bench.evaluation.engine import EngineOptions, find_job_runner
from minitouch_bench.files import (
    RUN_FILE,
    lock_directory,
    os_errors_as,
    read_file,
    write_file,
)
from minitouch_bench.policies.sources import EXPLORED_FILE, TRAINED_FILE
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.records import Count
from minitouch_bench.reporting.claims import Claim
from minitouch_bench.reporting.study import StudyResults, StudyTraining, write_study
from minitouch_bench.runs.plan import find_suite
from minitouch_bench.workflows import ignore
from minitouch_bench.workflows.evaluate import evaluate
from minitouch_bench.workflows.training import TrainingRequest, run_training

FAILURE_FILE = "failure.txt"
STUDY_FILE = "study.json"
MAY_CHANGE = ("methods", "tasks", "seeds", "exploration_steps", "suites", "per_task", "claims")
"""What of a study's file may differ between two starts; the rest would mix unlike trainings."""


@dataclass(frozen=True)
class TaskGrid:
    """What a study does otherwise in one task; None: as in the others."""

    methods: tuple[str, ...] | None = None
    exploration_steps: tuple[int, ...] | None = None
    task_steps: Count | None = None
    suites: tuple[str, ...] | None = None


@dataclass(frozen=True)
class StudyConfig:
    """A grid, as its TOML file says it.

    Every task is trained with every method from every seed, for every length of exploration in
    ``exploration_steps``. ``suites``: what each final policy is evaluated on, as far as the suite
    has the task. ``episodes`` per task; 0 for the suite's own. ``preset`` and ``settings`` are
    those of ``train``. ``per_task`` changes the grid in the tasks that it names. ``claims`` about
    its methods are judged together, over training seeds.
    """

    methods: tuple[str, ...]
    tasks: tuple[str, ...]
    seeds: tuple[int, ...] = (0, 1, 2)
    exploration_steps: tuple[int, ...] = (10_000,)
    task_steps: Count = 40_000
    suites: tuple[str, ...] = ("table4",)
    episodes: Count = 0
    preset: str = "default"
    settings: Mapping[str, Any] = field(default_factory=dict)
    per_task: Mapping[str, TaskGrid] = field(default_factory=dict)
    claims: tuple[Claim, ...] = ()

    def in_task(self, task: str) -> "StudyConfig":
        """Return the study as it is in one task."""
        changed = vars(self.per_task.get(task, TaskGrid())).items()
        return replace(self, **{name: value for name, value in changed if value is not None})

    def trainings(self) -> tuple[StudyTraining, ...]:
        """Return the trainings in the order in which they are started: seed by seed."""
        return tuple(
            StudyTraining(task, method, seed, steps)
            for seed in self.seeds
            for task in self.tasks
            for steps in self.in_task(task).exploration_steps
            for method in self.in_task(task).methods
        )

    def config_of(self, training: StudyTraining) -> TrainingConfig:
        """Return the settings of one training.

        Raises:
            UsageError: one of them does not exist.
        """
        task_steps = self.in_task(training.task).task_steps
        settings = {
            "method": training.method,
            "seed": training.seed,
            "exploration": {"steps": training.exploration_steps},
            "task_phase": {"steps": task_steps if training.task in GOAL_TASKS else 0},
        }
        given = make_config(training.task, self.preset, settings=self.settings)
        return apply_settings(given, settings)


def read_study(path: Path) -> StudyConfig:
    """Read a study's TOML file, and see that every training in it can be made.

    Raises:
        UsageError: it is not readable, or names what does not exist.
    """
    study = take_table(read_toml(path), StudyConfig, str(path))
    for name in ("methods", "tasks", "seeds", "exploration_steps", "suites"):
        for grid in (study, *study.per_task.values()):
            values = getattr(grid, name, None) or ()
            if len(set(values)) < len(values):
                raise UsageError(f"{path} has one of its {name} twice")
    if unknown := {*study.per_task} - {*study.tasks}:
        raise UsageError(f"{path} changes '{min(unknown)}', which is not one of its tasks")
    for training in study.trainings():
        study.config_of(training)
        for suite in study.in_task(training.task).suites:
            find_suite(suite)
    trained = {(training.task, training.method) for training in study.trainings()}
    for task, method in (pair for claim in study.claims for pair in claim.trained):
        if (task, method) not in trained:
            raise UsageError(f"{path} has a claim on {method} in {task}, and does not train it")
    return study


ONE_AT_A_TIME = EngineOptions(workers=1)
OnState = Callable[[StudyResults], None]
"""Takes which trainings are done, failed and left."""


def run_study(
    config: StudyConfig,
    directory: Path,
    engine: EngineOptions = ONE_AT_A_TIME,
    on_state: OnState = ignore,
) -> StudyResults:
    """Train and evaluate what is left, and write the report after each training.

    ``engine``: how many trainings run at a time here, or a Ray cluster.

    Raises:
        MiniTouchError: see ``study``.
    """
    run_jobs = find_job_runner(engine)
    with lock_directory(directory):
        _keep_settings(config, directory)
        for training in config.trainings():
            (_place(directory, training) / FAILURE_FILE).unlink(missing_ok=True)
        results = _look(config, directory, on_state)
        jobs = [_Job(config, directory.resolve(), training) for training in results.left]
        for job, failure in run_jobs(engine, _run, jobs):
            if failure:
                write_file(_place(directory, job.training) / FAILURE_FILE, failure + "\n")
            results = _look(config, directory, on_state)
    return results


def _keep_settings(config: StudyConfig, directory: Path) -> None:
    """Write a study's settings beside its results, once they agree with those there."""
    file = directory / STUDY_FILE
    if file.exists():
        with os_errors_as(RunDirectoryError, file, "read"):
            before = read_json(read_file(file), StudyConfig, str(file))
        grown = replace(before, **{name: getattr(config, name) for name in MAY_CHANGE})
        for one in fields(StudyConfig):
            then, now = getattr(grown, one.name), getattr(config, one.name)
            if then != now:
                raise RunDirectoryError(
                    f"{directory} was started with {one.name} = {then}, the file has {now}; "
                    "choose another --output"
                )
    write_file(file, write_json(config))


@dataclass(frozen=True)
class _Job:
    config: StudyConfig
    directory: Path
    training: StudyTraining

    def __str__(self) -> str:
        return self.training.name


def _run(job: _Job) -> str:
    """Train, then evaluate; return what went wrong in a line, "" if nothing did."""
    try:
        if not job.directory.is_dir():
            return f"{job.directory} is not on the machine that was to train it"
        place = _place(job.directory, job.training)
        config = job.config.config_of(job.training)
        if not (place / TRAINED_FILE).exists():  # its policy is enough: not the checkpoint
            run_training(TrainingRequest(config, place, resume=(place / CONFIG_FILE).exists()))
        for suite in _suites(job.config, job.training):
            _evaluate(job, suite)
    except MiniTouchError as error:
        return str(error).replace("\n", " ")
    return ""


def _evaluate(job: _Job, suite: str) -> None:
    # Relative, as run.json records it: it shall not name the directories of a machine.
    place = Path(os.path.relpath(_place(job.directory, job.training)))
    output = place / suite
    if (output / RUN_FILE).exists():
        return
    explored = place / EXPLORED_FILE
    has_exploration = explored.exists() and job.training.task in GOAL_TASKS
    evaluate(
        str(place / TRAINED_FILE),
        suite,
        tasks=(job.training.task,),
        episodes=job.config.episodes or None,
        exploration=str(explored) if has_exploration else None,
        name=job.training.name,
        workers=1,
        output=output,
        resume=output.exists(),
    )


def _suites(config: StudyConfig, training: StudyTraining) -> tuple[str, ...]:
    suites = config.in_task(training.task).suites
    return tuple(name for name in suites if training.task in find_suite(name).tasks)


def _place(directory: Path, training: StudyTraining) -> Path:
    return directory / training.name


def _look(config: StudyConfig, directory: Path, on_state: OnState) -> StudyResults:
    """Find out what is done, failed and left; write the report of it."""
    done, failed, left = [], {}, []
    for training in config.trainings():
        place = _place(directory, training)
        wanted = _suites(config, training)
        if (place / FAILURE_FILE).exists():
            failed[training] = (place / FAILURE_FILE).read_text(encoding="utf-8").strip()
        elif not (place / TRAINED_FILE).exists() or not all(
            (place / suite / RUN_FILE).exists() for suite in wanted
        ):
            left.append(training)
        elif unlike := _unlike(config, training, place):
            failed[training] = unlike
        else:
            done.append(training)
    results = StudyResults(directory, tuple(done), failed, tuple(left), config.claims)
    write_study(results)
    on_state(results)
    return results


def _unlike(config: StudyConfig, training: StudyTraining, place: Path) -> str:
    """Say how a finished training differs from the study's, as by another version; "" if not."""
    wanted = config.config_of(training)
    try:
        known = read_config(place / CONFIG_FILE, wanted)
    except UsageError as error:
        return str(error)
    return "" if known == wanted else f"{place / CONFIG_FILE} has other settings than the study"
