"""A study: a grid of trainings, each evaluated under the protocol, as a queue that can be resumed.

What is done is read off the files, so that a killed study goes on where it was.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

import msgspec

from minitouch_bench.agents.config import (
    CONFIG_FILE,
    TrainingConfig,
    apply_settings,
    make_config,
    read_config,
)
from minitouch_bench.documents import fault_in_words, read_toml
from minitouch_bench.errors import MiniTouchError, RunDirectoryError, UsageError
from minitouch_bench.evaluation.engine import EngineOptions, find_job_runner
from minitouch_bench.files import RUN_FILE, lock_directory, write_file
from minitouch_bench.policies.sources import EXPLORED_FILE, TRAINED_FILE
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.records import Count
from minitouch_bench.reporting.study import StudyResults, StudyTraining, write_study
from minitouch_bench.runs.plan import find_suite
from minitouch_bench.workflows import ignore
from minitouch_bench.workflows.evaluate import evaluate
from minitouch_bench.workflows.training import TrainingRequest, run_training

STUDIES = Path("reports") / "studies"
FAILURE_FILE = "failure.txt"
STUDY_FILE = "study.json"
MAY_GROW = ("methods", "tasks", "seeds", "exploration_steps", "suites")
"""What a study's file may change between two starts; the rest would mix unlike trainings."""


@dataclass(frozen=True)
class StudyConfig:
    """A grid, as its TOML file says it.

    Every task is trained with every method from every seed, for every length of exploration in
    ``exploration_steps``. ``suites``: what each final policy is evaluated on, as far as the suite
    has the task. ``episodes`` per task; 0 for the suite's own. ``preset`` and ``settings`` are
    those of ``train``.
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

    def trainings(self) -> tuple[StudyTraining, ...]:
        """Return the trainings in the order in which they are started: seed by seed."""
        grid = product(self.seeds, self.exploration_steps, self.tasks, self.methods)
        return tuple(StudyTraining(task, method, seed, steps) for seed, steps, task, method in grid)

    def config_of(self, training: StudyTraining) -> TrainingConfig:
        """Return the settings of one training.

        Raises:
            UsageError: one of them does not exist.
        """
        own = {
            "method": training.method,
            "seed": training.seed,
            "exploration": {"steps": training.exploration_steps},
            "task_phase": {"steps": self.task_steps if training.task in GOAL_TASKS else 0},
        }
        given = make_config(training.task, self.preset, settings=self.settings)
        config: TrainingConfig = apply_settings(given, own)
        return config


def read_study(path: Path) -> StudyConfig:
    """Read a study's TOML file, and see that every training in it can be made.

    Raises:
        UsageError: it is not readable, or names what does not exist.
    """
    document = read_toml(path)
    try:
        study = msgspec.convert(document, StudyConfig)
    except msgspec.ValidationError as error:
        raise UsageError(fault_in_words(error, str(path))) from error
    if unknown := sorted({*document} - {one.name for one in fields(StudyConfig)}):
        raise UsageError(f"{path} has no use for '{unknown[0]}'")
    for name in MAY_GROW:
        values = getattr(study, name)
        if len(set(values)) < len(values):
            raise UsageError(f"{path} has one of its {name} twice")
    for training in study.trainings():
        study.config_of(training)
    for suite in study.suites:
        find_suite(suite)
    return study


ONE_AT_A_TIME = EngineOptions(workers=1)


@dataclass(frozen=True)
class StudyOptions:
    """Which study, where, and what runs it: so many trainings at a time here, or a Ray cluster.

    ``on_state`` is told which trainings are done, failed and left, whenever that changes.
    """

    config: StudyConfig
    directory: Path
    engine: EngineOptions = ONE_AT_A_TIME
    on_state: Callable[[StudyResults], None] = ignore


def run_study(options: StudyOptions) -> StudyResults:
    """Train and evaluate what is left, and write the report after each training.

    A training that fails is named in the report and does not stop the others; the next start
    of the study tries it again.

    Raises:
        UsageError: no such engine, or an option has no meaning for it.
        MissingExtraError: Ray or, for the figures, matplotlib is not installed.
        InfrastructureError: no cluster answers.
        RunDirectoryError: the directory is in use, cannot be written, or was started with
            other settings.
    """
    directory = options.directory
    run_jobs = find_job_runner(options.engine)
    with lock_directory(directory):
        _keep_settings(options.config, directory)
        for training in options.config.trainings():
            (_place(directory, training) / FAILURE_FILE).unlink(missing_ok=True)
        found = _look(options)
        jobs = [_Job(options.config, directory.resolve(), training) for training in found.left]
        for job, failure in run_jobs(options.engine, _run, jobs):
            if failure:
                write_file(_place(directory, job.training) / FAILURE_FILE, failure + "\n")
            found = _look(options)
    return found


def _keep_settings(config: StudyConfig, directory: Path) -> None:
    """Write a study's settings beside its results, once they agree with those there."""
    file = directory / STUDY_FILE
    if file.exists():
        try:
            before = msgspec.json.decode(file.read_bytes(), type=StudyConfig)
        except (OSError, msgspec.MsgspecError) as error:
            raise RunDirectoryError(f"{file} cannot be read: {error}") from error
        grown = replace(before, **{name: getattr(config, name) for name in MAY_GROW})
        for one in fields(StudyConfig):
            then, now = getattr(grown, one.name), getattr(config, one.name)
            if then != now:
                raise RunDirectoryError(
                    f"{directory} was started with {one.name} = {then}, the file has {now}; "
                    "choose another --output"
                )
    write_file(file, msgspec.json.format(msgspec.json.encode(config)))


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
        run_training(TrainingRequest(config, place, resume=(place / CONFIG_FILE).exists()))
        for suite in _suites(job.config, job.training):
            _evaluate(job, suite)
    except MiniTouchError as error:
        return str(error).replace("\n", " ")
    return ""


def _evaluate(job: _Job, suite: str) -> None:
    place = _place(job.directory, job.training)
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
    return tuple(name for name in config.suites if training.task in find_suite(name).tasks)


def _place(directory: Path, training: StudyTraining) -> Path:
    return directory / training.name


def _look(options: StudyOptions) -> StudyResults:
    """Read off the files what is done, failed and left; write the report of it."""
    done, failed, left = [], {}, []
    for training in options.config.trainings():
        place = _place(options.directory, training)
        wanted = _suites(options.config, training)
        if (place / FAILURE_FILE).exists():
            failed[training] = (place / FAILURE_FILE).read_text(encoding="utf-8").strip()
        elif not (place / TRAINED_FILE).exists() or not all(
            (place / suite / RUN_FILE).exists() for suite in wanted
        ):
            left.append(training)
        elif unlike := _unlike(options.config, training, place):
            failed[training] = unlike
        else:
            done.append(training)
    found = StudyResults(options.directory, tuple(done), failed, tuple(left))
    write_study(found)
    options.on_state(found)
    return found


def _unlike(config: StudyConfig, training: StudyTraining, place: Path) -> str:
    """Say how a finished training differs from the study's, as by another version; "" if not."""
    wanted = config.config_of(training)
    try:
        known = read_config(place / CONFIG_FILE, wanted)
    except UsageError as error:
        return str(error)
    return "" if known == wanted else f"{place / CONFIG_FILE} has other settings than the study"
