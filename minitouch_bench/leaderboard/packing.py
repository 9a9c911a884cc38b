"""Pack policies as a submission, or remove a submission and its results."""

import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from itertools import product
from pathlib import Path
from typing import Any

from minitouch_bench import files
from minitouch_bench.agents.config import TrainingConfig, read_recorded_config
from minitouch_bench.episode import Role
from minitouch_bench.errors import PolicyLoadError, RunDirectoryError, UsageError
from minitouch_bench.evaluation.engine import Callbacks, Engine
from minitouch_bench.evaluation.policy_setup import prepare_policies
from minitouch_bench.json_io import write_toml
from minitouch_bench.leaderboard.play import Entry
from minitouch_bench.leaderboard.submission import NAME, Submission, mistakes
from minitouch_bench.policies import lerobot
from minitouch_bench.policies.formats import BUILT_IN, KIND_BY_SUFFIX
from minitouch_bench.policies.policy import DIRECTORY, SANDBOXED, IsolationOptions, PolicySource
from minitouch_bench.policies.sources import (
    ALL_TASKS,
    CONFIG_FILE,
    TRAINED,
    CheckpointFile,
    parse_source,
    read_checkpoint,
)
from minitouch_bench.protocol.minitouch import GOAL_TASKS, TASK_NAMES
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.text import printable

PACKING = ".packing"
"""Folder beside the submissions where one is made; the next call removes a killed call's."""

Checkpoints = Mapping[int, Mapping[CheckpointFile, Path]]
"""By training seed the files of its policies, and where each is now."""


def is_training(policy: str) -> bool:
    """Tell whether a POLICY is the directory of a training."""
    return (Path(policy) / CONFIG_FILE).is_file()


def pack_trainings(directories: Sequence[str]) -> tuple[Checkpoints, dict[str, Any]]:
    """Group training directories by their seed; return fields of ``Submission``, too.

    Their settings give these fields: method, learner, training steps, modalities.

    Raises:
        UsageError: two are of one task and seed, or the trainings are of unlike settings.
        RunDirectoryError, PolicyLoadError: one is damaged or unfinished.
    """
    by_seed: dict[int, dict[str, tuple[Path, TrainingConfig]]] = {}
    for directory in map(Path, directories):
        config = read_recorded_config(directory / CONFIG_FILE)
        of_seed = by_seed.setdefault(config.seed, {})
        if config.task in of_seed:
            both = f"{of_seed[config.task][0]} and {directory}"
            raise UsageError(f"{both} are trainings of {config.task} with one seed: give one")
        of_seed[config.task] = directory, config
    told = {seed: _about([one for _, one in of_seed.values()]) for seed, of_seed in by_seed.items()}
    if len({*map(repr, told.values())}) > 1:
        unlike = ", ".join(f"seed {seed}: {words}" for seed, words in told.items())
        raise UsageError(f"the trainings of a submission are alike but for their seeds; {unlike}")
    found: dict[int, dict[CheckpointFile, Path]] = {}
    for seed, of_seed in sorted(by_seed.items()):
        in_order = {task: of_seed[task] for task in TASK_NAMES if task in of_seed}
        files_of = found[seed] = {}
        for role in Role:
            for task, (directory, config) in in_order.items():
                path = directory / TRAINED[role]
                # In Playing the exploration policy is the final one. An exploration policy with
                # other senses than the final policy's is another method's.
                is_own = config.exploration.without == config.without
                if role is Role.FINAL or (task in GOAL_TASKS and is_own and path.exists()):
                    digest = parse_source(str(path)).digest
                    files_of[CheckpointFile(role, task, f"{task}{path.suffix}", digest)] = path
    return found, next(iter(told.values()))


def _about(configs: Sequence[TrainingConfig]) -> dict[str, Any]:
    """Return the fields of ``Submission`` that the settings of one seed's trainings give."""
    methods = {config.method for config in configs}
    without = {config.without for config in configs}
    if len(methods) > 1 or len(without) > 1:
        raise UsageError("the trainings of one seed have unlike methods or senses")
    (lacking,) = without
    touch = "proprioception" if "forces" in lacking else "touch"
    senses = {"vision": "vision", touch: "touch"}
    sees_keypoints = any(config.task_phase.learns_keypoints for config in configs)
    return {
        "method": methods.pop(),
        "learner": f"MiniTouch-bench SAC{' on keypoints' if sees_keypoints else ''}",
        "training_steps": sum(config.steps for config in configs),
        "modalities": tuple(name for name, sense in senses.items() if sense not in lacking),
    }


def pack_policies(
    policies: Sequence[str], explorations: Sequence[str], seeds: Sequence[int]
) -> Checkpoints:
    """Make a training of each policy and the exploration policy at the same place.

    Raises:
        UsageError: their numbers differ, two seeds are equal, or a policy is not files.
        PolicyLoadError: there is no such policy.
    """
    seeds = seeds or range(len(policies))
    counts = {len(seeds), len({*seeds}), len(explorations) or len(policies)}
    if counts != {len(policies)}:
        raise UsageError(
            f"there are {len(policies)} policies, {len({*seeds})} different training seeds and "
            f"{len(explorations)} exploration policies: give one of each for every training"
        )
    found = {}
    for number, seed in enumerate(seeds):
        found[seed] = dict(_files_of(parse_source(policies[number]), Role.FINAL))
        if explorations:
            source = parse_source(explorations[number], role=Role.EXPLORATION)
            found[seed] |= dict(_files_of(source, Role.EXPLORATION))
    return found


def _files_of(source: PolicySource, role: Role) -> Iterator[tuple[CheckpointFile, Path]]:
    """Yield the files of a policy; a built-in policy has none."""
    if role is Role.FINAL and source.kind in BUILT_IN:
        return
    for task, part in source.parts if source.kind == DIRECTORY else ((ALL_TASKS, source),):
        if part.kind not in KIND_BY_SUFFIX.values():
            raise UsageError(
                f"{source.name} is not a checkpoint: a row is played from files (see "
                "docs/reference/formats.md)"
            )
        path = Path(part.address or part.target)
        name = f"{task}{lerobot.SUFFIX}" if Path(part.target).is_dir() else path.name
        yield CheckpointFile(role, task, name, part.digest, part.address), path


def pack_submission(
    submission: Submission,
    checkpoints: Checkpoints,
    submissions: Path,
    engine: Engine,
    callbacks: Callbacks,
    *,
    isolation: IsolationOptions = SANDBOXED,
) -> Path:
    """Make a submission in a folder aside, try its policies, and move it to its name.

    Each policy is loaded and plays one episode per task. Files on the Hub are not copied.

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
                f"{target} is there: minitouch-bench leaderboard remove {target.name}, or "
                "choose another --name"
            )
        copy = folder / submission.name
        files.write_file(copy / files.SUBMISSION_FILE, write_toml(submission))
        for training in submission.trainings:
            for file, source in checkpoints[training.seed].items():
                if not file.address:
                    files.write_file(copy / training.place(file), read_checkpoint(source))
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
    """Play one episode per task and suite with each policy of each training.

    Raises:
        PolicyLoadError: a policy cannot be loaded, or fails.
    """
    trainings, explores = entry.submission.trainings, entry.submission.explores
    plans = [make_plan(suite, episodes=1) for suite in entry.submission.suites]
    count = sum(len(plan.specs(exploration=explores)) for plan in plans)
    callbacks.phase("trial episodes", len(trainings) * count)
    for training, plan in product(trainings, plans):
        policy = entry.policy(training)
        explorer = policy if explores else None
        setup = prepare_policies(policy, plan, isolation, callbacks.note, exploration=explorer)
        for record in engine.run(setup, plan.specs(exploration=explores)):
            callbacks.episode(record)
            if record.fault:
                text = f"{training.folder} fails in {record.spec.key}: {record.fault}"
                raise PolicyLoadError(text)


@contextmanager
def lock_aside(parent: Path) -> Iterator[Path]:
    """Hold an empty folder beside submissions or rows, which no board reads; then remove it."""
    folder = parent / PACKING
    with files.lock_directory(parent, wait=True):
        with files.os_errors_as(RunDirectoryError, folder, "cleared"):
            if os.path.lexists(folder):
                shutil.rmtree(folder)
            folder.mkdir()
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def remove_submission(submissions: Path, results: Path, name: str) -> list[Path]:
    """Remove a submission and its results, whichever is there; return the folders.

    Killed in between, it leaves nothing half removed.

    Raises:
        UsageError: neither is there.
        RunDirectoryError: the row is being played, or a file cannot be removed.
    """
    is_name = re.search(str(NAME.pattern), name)  # so that it leads nowhere else
    there = [*filter(files.is_folder, (submissions / name, results / name))] if is_name else []
    if not there:
        raise UsageError(f"there is no submission '{printable(name)}' in {submissions}")
    with ExitStack() as stack:
        if results / name in there:
            stack.enter_context(files.lock_directory(results / name))  # as ``play`` does
        asides = [stack.enter_context(lock_aside(path.parent)) for path in there]
        for path, aside in zip(there, asides, strict=True):
            with files.os_errors_as(RunDirectoryError, path, "removed"):
                path.rename(aside / name)
    return there
