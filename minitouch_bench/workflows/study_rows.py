"""A study's method as a submission: per training seed the policies of all tasks, and their runs."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from minitouch_bench.agents.config import trained_steps
from minitouch_bench.documents import read_json
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.files import (
    VIDEOS,
    list_videos,
    make_folder,
    os_errors_as,
    read_file,
    write_file,
)
from minitouch_bench.leaderboard.packing import Parts
from minitouch_bench.leaderboard.submission import checkpoint_place
from minitouch_bench.policies.sources import TRAINED, PolicySource, identify, parse_source
from minitouch_bench.protocol.minitouch import GOAL_TASKS, MAIN_SUITE
from minitouch_bench.records import Role
from minitouch_bench.runs.joining import join_runs
from minitouch_bench.runs.plan import find_suite
from minitouch_bench.runs.run import Run
from minitouch_bench.workflows.study_config import STUDY_FILE, StudyConfig
from minitouch_bench.workflows.studying import finished_runs


@dataclass(frozen=True)
class StudyRow:
    """One method of a study, each task at its longest exploration.

    ``trainings``: the training directory of each seed and task. ``runs``: the runs of each seed
    and suite, one per task.
    """

    method: str
    trainings: Mapping[int, Mapping[str, Path]]
    runs: Mapping[int, Mapping[str, Sequence[Run]]]

    def training_steps(self) -> int:
        """Return the control steps of one training seed, all tasks together."""
        return sum(map(trained_steps, next(iter(self.trainings.values())).values()))

    def parts(self, seed: int, folder: Path, submission: Path) -> Parts:
        """Collect a training seed's policies, joined runs and their videos in an empty folder.

        The runs name the policies where they will be: in the ``submission``.

        Raises:
            UsageError: the runs have different plans, or some goal tasks no exploration policy.
            PolicyLoadError, RunDirectoryError: a file cannot be read or written.
        """
        places = self.trainings[seed]
        policies = {
            Role.FINAL: places,
            Role.EXPLORATION: {
                task: place
                for task, place in places.items()
                if task in GOAL_TASKS and (place / TRAINED[Role.EXPLORATION]).is_file()
            },
        }
        if 0 < len(policies[Role.EXPLORATION]) < len(GOAL_TASKS):
            raise UsageError(
                f"{self.method} explored in {', '.join(policies[Role.EXPLORATION])} alone: "
                f"a submission has exploration policies of {', '.join(GOAL_TASKS)}, or none"
            )
        sources = {
            role: self._collect(of_task, role, seed, folder, submission)
            for role, of_task in policies.items()
            if of_task
        }
        final, explored = sources[Role.FINAL], sources.get(Role.EXPLORATION)
        runs = {}
        for suite, of_suite in self.runs[seed].items():
            # The exploration metric is one of Table 4 alone.
            explorer = explored if suite == MAIN_SUITE else None
            runs[suite] = make_folder(folder / suite)
            identity = None if explorer is None else identify(explorer)
            join_runs(of_suite, identify(final), identity, runs[suite])
            for video in (video for run in of_suite for video in _videos(run)):
                write_file(make_folder(runs[suite] / VIDEOS) / video.name, read_file(video))
        return Parts(runs, final, explored)

    def _collect(
        self, places: Mapping[str, Path], role: Role, seed: int, folder: Path, submission: Path
    ) -> PolicySource:
        """Copy the policies of a role under the names of their tasks."""
        directory = make_folder(folder / role.value)
        for task, place in places.items():
            file = place / TRAINED[role]
            with os_errors_as(RunDirectoryError, file, "read"):
                write_file(directory / f"{task}{file.suffix}", read_file(file))
        source = parse_source(str(directory), role=role)
        there = submission / checkpoint_place(seed, role, "")
        return replace(source, name=self.method, address=str(there))


def _videos(run: Run) -> list[Path]:
    return [] if run.directory is None else list_videos(run.directory)


def find_study_row(study: Path, method: str | None, suites: Sequence[str]) -> StudyRow | None:
    """Return the row of a study's method; None if the directory is not a study's.

    Raises:
        UsageError: the study does not have the method in every task of ``table4``, or not all its
            official runs of the suites.
        RunDirectoryError: a file cannot be read, or is of other settings or another protocol.
    """
    file = study / STUDY_FILE
    if not os.path.isfile(file):  # Path's own fails in a directory that cannot be read
        return None
    with os_errors_as(RunDirectoryError, file, "read"):
        config = read_json(read_file(file), StudyConfig, str(file))
    tasks = find_suite(MAIN_SUITE).tasks
    methods = [config.in_task(task).methods if task in config.tasks else () for task in tasks]
    complete = [name for name in methods[0] if all(name in of_task for of_task in methods)]
    if method not in complete:
        known = f"with every task it has {', '.join(complete)}" if complete else "it lacks a task"
        raise UsageError(f"{study} is a study: choose one of its methods with --method; {known}")
    if config.episodes not in (0, find_suite(MAIN_SUITE).episodes_per_task):
        raise UsageError(f"{study} plays {config.episodes} episodes per task: it is not official")
    trainings: dict[int, dict[str, Path]] = {seed: {} for seed in config.seeds}
    played: dict[int, dict[str, tuple[Run, ...]]] = {seed: {} for seed in config.seeds}
    in_order = sorted(config.trainings(), key=lambda one: one.exploration_steps)
    for one in (one for one in in_order if one.method == method):
        trainings[one.seed][one.task] = study / one.name
        played[one.seed][one.task] = finished_runs(config, study, one)
    runs: dict[int, dict[str, list[Run]]] = {}
    for seed, of_task in played.items():
        runs[seed] = {suite: [] for suite in suites}
        for suite in suites:
            for task in find_suite(suite).tasks:
                found = [
                    run
                    for run in of_task[task]
                    if run.plan.suite == suite and not run.plan.conditions.in_words()
                ]
                if not found:
                    raise UsageError(f"{trainings[seed][task]} has no run of {suite}")
                runs[seed][suite] += found
    return StudyRow(str(method), trainings, runs)
