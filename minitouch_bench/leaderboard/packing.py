"""Pack policies as a submission, or remove a submission and its results."""

import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from minitouch_bench import files
from minitouch_bench.agents.config import TrainingConfig, read_recorded_config
from minitouch_bench.episode import Role
from minitouch_bench.errors import PolicyLoadError, RunDirectoryError, UsageError
from minitouch_bench.evaluation.engine import Callbacks, Engine
from minitouch_bench.evaluation.policy_setup import prepare_policies
from minitouch_bench.json_io import write_toml
from minitouch_bench.leaderboard.entry import Entry
from minitouch_bench.leaderboard.submission import NAME, Submission, check_submission, mistakes
from minitouch_bench.policies import lerobot
from minitouch_bench.policies.policy import (
    BUILT_IN,
    DIRECTORY,
    FORMATS,
    SANDBOXED,
    IsolationOptions,
    PolicySource,
)
from minitouch_bench.policies.sources import (
    ALL_TASKS,
    CONFIG_FILE,
    HUB,
    TRAINED,
    CheckpointFile,
    SubmittedTraining,
    parse_hub_address,
    parse_source,
    read_checkpoint,
)
from minitouch_bench.protocol.minitouch import GOAL_TASKS, TASK_NAMES
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.text import printable

PACKING = ".packing"
"""Folder beside the submissions where one is made; the next call removes a killed call's."""


@dataclass(frozen=True)
class PackedTraining:
    """A training, and the paths of its files that are copied; files on the Hub are not."""

    training: SubmittedTraining
    files: Mapping[CheckpointFile, Path]


def is_training(policy: str) -> bool:
    """Tell whether a POLICY is the directory of a training."""
    return (Path(policy) / CONFIG_FILE).is_file()


def pack_trainings(directories: Sequence[str]) -> tuple[list[PackedTraining], dict[str, Any]]:
    """Group training directories by their seed; return them, and fields of ``Submission``.

    Their settings give these fields: method, learner, training steps, modalities.

    Raises:
        UsageError: two are of one task and seed, or the trainings are of unlike settings.
        RunDirectoryError, PolicyLoadError: one is damaged or unfinished.
    """
    by_seed: dict[int, dict[str, Path]] = {}
    configs: dict[int, list[TrainingConfig]] = {}
    for directory in map(Path, directories):
        config = read_recorded_config(directory / CONFIG_FILE)
        of_seed = by_seed.setdefault(config.seed, {})
        if config.task in of_seed:
            both = f"{of_seed[config.task]} and {directory}"
            raise UsageError(f"{both} are trainings of {config.task} with one seed: give one")
        of_seed[config.task] = directory
        configs.setdefault(config.seed, []).append(config)
    told = {seed: _about(of_seed) for seed, of_seed in configs.items()}
    if len({*map(repr, told.values())}) > 1:
        unlike = ", ".join(f"seed {seed}: {words}" for seed, words in told.items())
        raise UsageError(f"the trainings of a submission are alike but for their seeds; {unlike}")
    packed = []
    for seed, of_seed in sorted(by_seed.items()):
        found: dict[CheckpointFile, Path] = {}
        for role in Role:
            for task in TASK_NAMES:
                if task in of_seed and (role is Role.FINAL or _explored(of_seed[task], task)):
                    path = of_seed[task] / TRAINED[role]
                    source = parse_source(str(path))
                    file = CheckpointFile(role, task, f"{task}{path.suffix}", source.digest)
                    found[file] = path
        packed.append(PackedTraining(SubmittedTraining(seed, tuple(found)), found))
    return packed, next(iter(told.values()))


def _explored(directory: Path, task: str) -> bool:
    """Tell whether a training has an exploration policy to rate; in Playing it is the final one."""
    return task in GOAL_TASKS and (directory / TRAINED[Role.EXPLORATION]).exists()


def _about(configs: Sequence[TrainingConfig]) -> dict[str, Any]:
    """Return the fields of ``Submission`` that the settings of one seed's trainings give."""
    methods = {config.method for config in configs}
    without = {config.without for config in configs}
    if len(methods) > 1 or len(without) > 1:
        raise UsageError("the trainings of one seed have unlike methods or senses")
    (lacking,) = without
    touch = "proprioception" if "forces" in lacking else "touch"
    senses = {"vision": "vision", touch: "touch"}
    sees_keypoints = any(config.task_phase.keypoint_updates for config in configs)
    return {
        "method": methods.pop(),
        "learner": f"MiniTouch-bench SAC{' on keypoints' if sees_keypoints else ''}",
        "training_steps": sum(config.steps for config in configs),
        "modalities": tuple(name for name, sense in senses.items() if sense not in lacking),
    }


def pack_policies(
    policies: Sequence[str], explorations: Sequence[str], seeds: Sequence[int]
) -> list[PackedTraining]:
    """Make a training of each policy and the exploration policy at the same place.

    Raises:
        UsageError: their numbers differ, or a policy is not files.
        PolicyLoadError: there is no such policy.
    """
    seeds = seeds or range(len(policies))
    if len(seeds) != len(policies) or len(explorations) not in (0, len(policies)):
        raise UsageError(
            f"there are {len(policies)} policies, {len(seeds)} training seeds and "
            f"{len(explorations)} exploration policies: give one of each for every training"
        )
    packed = []
    for number, seed in enumerate(seeds):
        found = dict(_files_of(parse_source(policies[number]), Role.FINAL))
        if explorations:
            source = parse_source(explorations[number], role=Role.EXPLORATION)
            found |= dict(_files_of(source, Role.EXPLORATION))
        copied = {file: path for file, path in found.items() if not file.address}
        packed.append(PackedTraining(SubmittedTraining(seed, tuple(found)), copied))
    return packed


def _files_of(source: PolicySource, role: Role) -> Iterator[tuple[CheckpointFile, Path]]:
    """Yield the files of a policy; a built-in policy has none."""
    if role is Role.FINAL and source.kind in BUILT_IN:
        return
    for task, part in source.parts if source.kind == DIRECTORY else ((ALL_TASKS, source),):
        if part.kind not in FORMATS:
            raise UsageError(
                f"{source.name} is not a checkpoint: a row is played from files (see "
                "docs/reference/formats.md), which a maintainer can run in the sandbox"
            )
        path, address = Path(part.target), ""
        if part.address:
            hub = parse_hub_address(part.address)
            path, address = Path(hub.file), f"{HUB}{hub.repository}@{hub.revision}/{hub.file}"
        name = f"{task}{lerobot.SUFFIX}" if Path(part.target).is_dir() else path.name
        yield CheckpointFile(role, task, name, part.digest, address), path


def pack_submission(
    submission: Submission,
    trainings: Sequence[PackedTraining],
    submissions: Path,
    engine: Engine,
    callbacks: Callbacks,
    *,
    isolation: IsolationOptions = SANDBOXED,
) -> Path:
    """Make a submission in a folder aside, try its policies, and move it to its name.

    Each policy is loaded and plays one episode per task.

    Raises:
        RunDirectoryError: one of this name is there, or a file cannot be read or written.
        UsageError: the submission does not pass the check.
        PolicyError: a policy cannot be loaded, or fails in its episode.
    """
    for mistake in mistakes(submission):
        raise UsageError(mistake)
    target = submissions / submission.name
    with lock_aside(submissions) as folder:
        if os.path.lexists(target):
            raise RunDirectoryError(
                f"{target} is there: minitouch-bench leaderboard remove {target.name}, or choose "
                "another --name"
            )
        copy = folder / submission.name
        files.write_file(copy / files.SUBMISSION_FILE, write_toml(submission))
        for one in trainings:
            for file, source in one.files.items():
                files.write_file(copy / one.training.place(file), read_checkpoint(source))
        for problem in check_submission(copy):
            raise UsageError(problem)
        try:
            _try_policies(Entry(copy, submission, folder), engine, callbacks, isolation)
        except PolicyLoadError as error:  # the folder aside is gone when a user reads it
            raise PolicyLoadError(str(error).replace(f"{copy}/", "")) from error
        with files.os_errors_as(RunDirectoryError, target, "written"):
            copy.rename(target)
    return target


def _try_policies(
    entry: Entry, engine: Engine, callbacks: Callbacks, isolation: IsolationOptions
) -> None:
    """Play one episode per task with each policy of each training.

    Raises:
        PolicyLoadError: a policy cannot be loaded, or fails.
    """
    plan = make_plan(entry.submission.suites[0], episodes=1)
    setups = []
    for training in entry.submission.trainings:
        policy = entry.policy(training)
        explorer = policy if training.files(Role.EXPLORATION) else None
        setup = prepare_policies(policy, plan, isolation, callbacks.note, exploration=explorer)
        setups.append((training.folder, setup, plan.specs(exploration=explorer is not None)))
    callbacks.phase("trial episodes", sum(len(specs) for _, _, specs in setups))
    for name, setup, specs in setups:
        for record in engine.run(setup, specs):
            callbacks.episode(record)
            if record.fault:
                raise PolicyLoadError(f"{name} fails in {record.spec.key}: {record.fault}")


@contextmanager
def lock_aside(submissions: Path) -> Iterator[Path]:
    """Hold an empty folder beside the submissions, which no board reads; remove it afterwards."""
    folder = submissions / PACKING
    with files.lock_directory(submissions, wait=True):
        with files.os_errors_as(RunDirectoryError, folder, "cleared"):
            if os.path.lexists(folder):
                shutil.rmtree(folder)
            folder.mkdir()
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def find_removable(submissions: Path, results: Path, name: str) -> dict[Path, str]:
    """Return the folders of a submission and of its results that are there, with their sizes.

    Raises:
        UsageError: neither is there.
    """
    there: dict[Path, str] = {}
    if re.search(str(NAME.pattern), name):  # so that it leads nowhere else
        for folder in filter(files.is_folder, (submissions / name, results / name)):
            sizes = [path.lstat().st_size for path in folder.rglob("*") if not path.is_dir()]
            there[folder] = f"{len(sizes)} files, {sum(sizes) / files.MIB:.1f} MiB"
    if not there:
        raise UsageError(f"there is no submission '{printable(name)}' in {submissions}")
    return there


def remove_submission(submissions: Path, there: Iterable[Path]) -> None:
    """Remove what ``find_removable`` found; killed in between, it leaves nothing half removed.

    Raises:
        RunDirectoryError: a file cannot be removed.
    """
    with lock_aside(submissions) as aside:
        for number, path in enumerate(there):
            with files.os_errors_as(RunDirectoryError, path, "removed"):
                path.rename(aside / str(number))
