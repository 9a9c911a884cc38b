"""A study's method as a submission: per training seed the policies of all tasks, and their runs."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from minitouch_bench.agents.config import trained_steps
from minitouch_bench.documents import read_json
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.files import RUN_FILE, make_folder, os_errors_as, read_file, write_file
from minitouch_bench.leaderboard.packing import Parts
from minitouch_bench.leaderboard.submission import SUBMITTED_SUITES
from minitouch_bench.policies.sources import TRAINED, PolicySource, identify, parse_source
from minitouch_bench.protocol.minitouch import GOAL_TASKS, MAIN_SUITE
from minitouch_bench.records import Role
from minitouch_bench.runs.joining import join_runs
from minitouch_bench.runs.plan import find_suite
from minitouch_bench.runs.run import read_run
from minitouch_bench.workflows.study_config import STUDY_FILE, StudyConfig

ALL_TASKS = find_suite(MAIN_SUITE).tasks


@dataclass(frozen=True)
class StudyRow:
    """One method of a study, each task at its longest exploration.

    ``trainings``: the training directory of each seed and task.
    """

    study: Path
    method: str
    trainings: Mapping[int, Mapping[str, Path]]

    def training_steps(self) -> int:
        """Return the control steps of one training seed, all tasks together."""
        return sum(map(trained_steps, next(iter(self.trainings.values())).values()))

    def parts(self, seed: int, folder: Path) -> Parts:
        """Collect a training seed's policies and joined runs in an empty folder.

        Raises:
            UsageError: two runs have different plans, or a policy is not the evaluated one.
            PolicyLoadError, RunDirectoryError: a file cannot be read or written.
        """
        places = self.trainings[seed]
        final = self._policies(places, Role.FINAL, folder)
        explored = None
        if any((place / TRAINED[Role.EXPLORATION]).is_file() for place in places.values()):
            goals = {task: place for task, place in places.items() if task in GOAL_TASKS}
            explored = self._policies(goals, Role.EXPLORATION, folder)
        runs = {}
        for suite in SUBMITTED_SUITES:
            files = {task: places[task] / suite / RUN_FILE for task in find_suite(suite).tasks}
            if not all(file.is_file() for file in files.values()):
                continue
            opened = {task: read_run(file) for task, file in files.items()}
            # The exploration metric is one of Table 4 alone.
            explorer = explored if suite == MAIN_SUITE else None
            for task, run in opened.items():
                for source, known in (
                    (final, run.header.policy),
                    (explorer, run.header.exploration),
                ):
                    if source and known and source.for_task(task).digest != known.digest:
                        raise UsageError(f"{files[task]} is of another policy than {places[task]}")
            runs[suite] = make_folder(folder / suite)
            identity = None if explorer is None else identify(explorer)
            join_runs([*opened.values()], identify(final), identity, runs[suite])
        return Parts(runs, final, explored)

    def _policies(self, places: Mapping[str, Path], role: Role, folder: Path) -> PolicySource:
        """Copy the policies of a role under the names of their tasks."""
        directory = make_folder(folder / role.value)
        for task, place in places.items():
            file = place / TRAINED[role]
            with os_errors_as(RunDirectoryError, file, "read"):
                write_file(directory / f"{task}{file.suffix}", read_file(file))
        source = parse_source(str(directory), role=role)
        return replace(source, name=self.method, address=str(self.study))


def find_row(study: Path, method: str | None) -> StudyRow | None:
    """Return the row of a study's method; None if the directory is not a study's.

    Raises:
        UsageError: the study does not have the method in every task of ``table4``, or is not done.
        RunDirectoryError: ``study.json`` cannot be read.
    """
    file = study / STUDY_FILE
    if not file.is_file():
        return None
    with os_errors_as(RunDirectoryError, file, "read"):
        config = read_json(read_file(file), StudyConfig, str(file))
    known = [one for one in config.trainings() if one.method == method]
    trainings: dict[int, dict[str, Path]] = {seed: {} for seed in config.seeds}
    for one in sorted(known, key=lambda one: one.exploration_steps):
        trainings[one.seed][one.task] = study / one.name
    for task in ALL_TASKS:
        if method is None or any(task not in places for places in trainings.values()):
            methods = ", ".join(config.methods)
            raise UsageError(
                f"{study} is a study: choose with --method one that it trains in {task} "
                f"(its methods are {methods})"
            )
    for place in (place for places in trainings.values() for place in places.values()):
        if not (place / MAIN_SUITE / RUN_FILE).is_file():
            raise UsageError(f"{place} has no run of {MAIN_SUITE}: continue the study first")
    return StudyRow(study, method or "", trainings)
