"""A study: a grid of trainings, each evaluated under the protocol, as a queue that can be resumed.

The files say what is done, so a killed study continues where it was.
"""

import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from minitouch_bench.agents.config import CONFIG_FILE, read_config
from minitouch_bench.documents import read_json, write_json
from minitouch_bench.errors import MiniTouchError, RunDirectoryError
from minitouch_bench.evaluation.engine import EngineOptions, find_job_runner
from minitouch_bench.files import (
    RUN_FILE,
    lock_directory,
    os_errors_as,
    read_file,
    write_file,
)
from minitouch_bench.policies.sources import EXPLORED_FILE, TRAINED_FILE, parse_source
from minitouch_bench.protocol.minitouch import GOAL_TASKS, MAIN_SUITE
from minitouch_bench.reporting.study import StudyResults, StudyTraining, write_study
from minitouch_bench.runs.run import Run, read_run
from minitouch_bench.workflows import ignore
from minitouch_bench.workflows.evaluate import evaluate
from minitouch_bench.workflows.study_config import STUDY_FILE, StudyConfig
from minitouch_bench.workflows.training import run_training

FAILURE_FILE = "failure.txt"
MAY_CHANGE = (
    "methods", "tasks", "seeds", "exploration_steps", "suites", "per_task", "claims", "conditions",
)  # fmt: skip
"""What of a study's file may differ between two starts; the rest would mix unlike trainings."""


ONE_AT_A_TIME = EngineOptions(workers=1)
OnState = Callable[[StudyResults], None]
"""Takes which trainings are done, failed and left."""


def run_study(
    config: StudyConfig,
    directory: Path,
    engine: EngineOptions = ONE_AT_A_TIME,
    on_state: OnState = ignore,
    wanted: Collection[StudyTraining] | None = None,
) -> StudyResults:
    """Train and evaluate what is left, and write the report after each training.

    ``engine``: how many trainings run at a time here, or a Ray cluster. ``wanted``: the trainings
    to make now, by default all.

    Raises:
        MiniTouchError: see ``study``.
    """
    run_jobs = find_job_runner(engine)
    with lock_directory(directory):
        _keep_settings(config, directory)
        for training in config.trainings() if wanted is None else wanted:
            (directory / training.name / FAILURE_FILE).unlink(missing_ok=True)
        results = report_study(config, directory, on_state)
        jobs = [
            _Job(config, directory.resolve(), training)
            for training in results.left
            if wanted is None or training in wanted
        ]
        for job, failure in run_jobs(engine, _run, jobs):
            if failure:
                write_file(directory / job.training.name / FAILURE_FILE, failure + "\n")
            results = report_study(config, directory, on_state)
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
        place = job.directory / job.training.name
        config = job.config.config_of(job.training)
        if not (place / TRAINED_FILE).exists():  # its policy is enough: not the checkpoint
            run_training(config, place, resume=(place / CONFIG_FILE).exists())
        for name, asked in job.config.evaluations_of(job.training).items():
            _evaluate(job, name, asked)
    except MiniTouchError as error:
        return str(error).replace("\n", " ")
    return ""


def _evaluate(job: _Job, name: str, asked: Mapping[str, Any]) -> None:
    # Relative, so that run.json does not contain this machine's directories.
    place = Path(os.path.relpath(job.directory / job.training.name))
    output = place / name
    if (output / RUN_FILE).exists():
        return
    explored = _explored(place, job.training.task, name)
    evaluate(
        str(place / TRAINED_FILE),
        **asked,
        tasks=(job.training.task,),
        exploration=None if explored is None else str(explored),
        name=job.training.name,
        workers=1,
        output=output,
        resume=output.exists(),
    )


def _explored(place: Path, task: str, name: str) -> Path | None:
    """Return the exploration policy of an evaluation; it is a metric of Table 4 alone."""
    file = place / EXPLORED_FILE
    return file if name == MAIN_SUITE and task in GOAL_TASKS and file.exists() else None


def report_study(config: StudyConfig, directory: Path, on_state: OnState) -> StudyResults:
    """Find out what is done, failed and left, write the report of it, and return it.

    Raises:
        RunDirectoryError: a file cannot be read or written.
    """
    done: list[StudyTraining] = []
    left: list[StudyTraining] = []
    untrained: list[StudyTraining] = []
    failed: dict[StudyTraining, str] = {}
    runs: dict[StudyTraining, tuple[Run, ...]] = {}
    for training in config.trainings():
        try:
            runs[training] = finished_runs(config, directory, training)
        except MiniTouchError as error:
            failed[training] = str(error)
        else:
            whole = len(runs[training]) == len(config.evaluations_of(training))
            trained = (directory / training.name / TRAINED_FILE).exists()
            (done if whole and trained else left).append(training)
            if not trained:
                untrained.append(training)
    results = StudyResults(
        directory, tuple(done), failed, tuple(left), tuple(untrained), runs, config.claims
    )
    write_study(results)
    on_state(results)
    return results


def finished_runs(config: StudyConfig, directory: Path, training: StudyTraining) -> tuple[Run, ...]:
    """Return the finished runs of a training among those that the study's file asks for.

    Raises:
        RunDirectoryError: the training failed, has other settings than the study, or a run is of
            another policy or of another protocol.
        UsageError: the training's settings cannot be read.
    """
    place = directory / training.name
    if (place / FAILURE_FILE).exists():
        raise RunDirectoryError((place / FAILURE_FILE).read_text(encoding="utf-8").strip())
    if not (place / TRAINED_FILE).exists():
        return ()
    wanted = config.config_of(training)
    if read_config(place / CONFIG_FILE, wanted) != wanted:
        raise RunDirectoryError(f"{place / CONFIG_FILE} has other settings than the study")
    policy = parse_source(str(place / TRAINED_FILE)).digest
    runs = []
    for name in config.evaluations_of(training):
        if not (place / name / RUN_FILE).exists():
            continue
        run = read_run(place / name)
        explored = _explored(place, training.task, name)
        policies = [policy] if explored is None else [policy, parse_source(str(explored)).digest]
        if [known.digest for known in run.header.policies()] != policies:
            raise RunDirectoryError(f"{place / name} is of another policy: remove it")
        if run.header.task_digests != run.plan.rules():
            raise RunDirectoryError(f"{place / name} is of another protocol: remove it")
        runs.append(run)
    return tuple(runs)
