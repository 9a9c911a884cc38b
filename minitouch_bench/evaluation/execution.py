"""Begin or resume a run, play the episodes that are missing, and make the finished run."""

import contextlib
import hashlib
import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from minitouch_bench import errors, files
from minitouch_bench.episode import EpisodeSpec, Outcome, PlayedEpisode
from minitouch_bench.evaluation.engine import Callbacks, Engine
from minitouch_bench.evaluation.policy_setup import PolicySetup
from minitouch_bench.evaluation.rollout import EpisodeRunner
from minitouch_bench.machine import installed_versions, machine_facts, require, require_minari
from minitouch_bench.policies.formats import computing_packages
from minitouch_bench.runs.actions import write_actions
from minitouch_bench.runs.journal import Journal, check_same, read_header
from minitouch_bench.runs.plan import first_of
from minitouch_bench.runs.run import (
    Run,
    RunEnvironment,
    RunHeader,
    make_header,
    make_run,
    read_run,
    run_json,
)
from minitouch_bench.simulation.builds import BUILDS
from minitouch_bench.tasks.environment import OBJECT, MiniTouchEnv

PACKAGES = ("minitouch-bench", *BUILDS, "gymnasium", "numpy", *computing_packages())
"""What a run's numbers may depend on; those that are installed stand in ``run.json``."""

HOPELESS_AFTER = 10
"""A run whose first episodes, this many, are all policy faults ends there."""

LONGEST_NAME = 80
"""Characters of a policy in a run's name, and of what differs from its suite."""


def header_of(setup: PolicySetup) -> RunHeader:
    """Return what fixes the numbers of the run that plays this."""
    policy, explorer = setup.policy, setup.exploration
    exploration = None if explorer is None else explorer.identity()
    return make_header(setup.plan, policy.identity(), exploration, setup.isolation_level())


def run_name(header: RunHeader) -> str:
    """Name a run after its policy, suite and what differs from the suite, fit for a file name."""
    policy = _file_name(header.policy.name)[:LONGEST_NAME] or "policy"
    changes = "-".join(map(_file_name, header.plan.differences()))
    if len(changes) > LONGEST_NAME:  # the digest tells apart what is the same up to here
        digest = hashlib.sha256(changes.encode()).hexdigest()[:8]
        changes = f"{_file_name(changes[: LONGEST_NAME - 9])}-{digest}"
    return "-".join(filter(None, (policy, header.plan.suite, changes)))


def default_directory(header: RunHeader, ending: str = "") -> Path:
    """Return the directory of a run without ``--output``, which has its name and ``ending``.

    Where the run of a policy of another format has it already, as of x.onnx beside x.pt2, the name
    has the format, too.
    """
    usual = files.REPORTS / f"{run_name(header)}{ending}"
    with contextlib.suppress(errors.RunDirectoryError):
        if read_header(usual).policy.kind != header.policy.kind:
            name = f"{header.policy.name} {header.policy.kind}"
            other = replace(header, policy=replace(header.policy, name=name))
            return files.REPORTS / f"{run_name(other)}{ending}"
    return usual


def _file_name(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "-", text).strip(".-")


def open_run(
    header: RunHeader, directory: Path | None = None, *, resume: bool = False, fresh: bool = False
) -> Journal | Run:
    """Begin a run in a locked directory, or read what is done; a finished run is returned itself.

    Without a directory the run is kept in memory only.

    Raises:
        UsageError: both ``resume`` and ``fresh``.
        RunDirectoryError: it holds a run and neither was asked for, or one that cannot be
            resumed; the text says why. Or it holds other files and no run; or it cannot be
            written.
    """
    if resume and fresh:
        raise errors.UsageError("choose one of --resume and --fresh")
    if directory is None:
        return Journal(header)
    if fresh:
        files.clear_run(directory)
    if not files.holds_run(directory):
        if not fresh:
            _check_empty(directory)
        return Journal.begin(header, package_versions(), directory)
    done: Journal | Run
    try:
        if (directory / files.RUN_FILE).exists():
            done = read_run(directory)
            check_same(header, done.header, directory)
        else:
            done = Journal.resume(header, package_versions(), directory)
    except errors.RunDirectoryError as error:
        advice = "Replace it with --fresh, or choose another --output"
        raise type(error)(f"{error}.\n{advice}") from error
    if not resume:
        raise errors.RunDirectoryError(
            f"{directory} already contains this run of {header.policy.name} on "
            f"{header.plan.suite}.\n"
            "Add --resume to continue it, --fresh to replace it, or choose another --output"
        )
    if isinstance(done, Run):
        Journal(header, directory).remove()  # a crash after the last file left it
    return done


def _check_empty(directory: Path) -> None:
    """Refuse a directory of other files: one of them could be called as one of a run is."""
    if entries := files.entries_of(directory):
        first = first_of([ascii(name) for name in entries], 1)
        raise errors.RunDirectoryError(
            f"{directory} is not empty and does not contain a run: {first}.\n"
            "Choose another directory; or add --fresh: files called as a run's are then replaced"
        )


def play_missing(
    setup: PolicySetup,
    journal: Journal,
    engine: Engine,
    on_record: Callable[[PlayedEpisode], None],
) -> Run:
    """Play the episodes that are missing, and return the whole run.

    The journal keeps each record before ``on_record`` sees it. Where the run has a directory,
    ``actions.npz`` is written there at the end.

    Raises:
        InfrastructureError: the run is incomplete; what is done is kept.
        HopelessRunError: so is one whose first episodes are all policy faults; a run that is
            resumed after them goes on.
    """
    header, directory, records = journal.header, journal.directory, journal.records
    specs = header.specs()
    missing = [spec for spec in specs if spec not in records]
    # Use the first planned episodes. Which finish first depends on the number of workers.
    first = specs[:HOPELESS_AFTER] if len(specs) > HOPELESS_AFTER else ()
    started, clock, workers = datetime.now(UTC), time.monotonic(), engine.workers
    if directory is not None:
        setup = setup.keep_out_of(directory)
    for record in engine.run(setup, missing):
        journal.keep(record)
        on_record(record)
        if record.spec in first and all(spec in records for spec in first):
            played = [records[spec] for spec in first]
            if all(one.outcome is Outcome.POLICY_FAULT for one in played):
                text = f"the first {len(first)} episodes are all policy faults: {played[0].fault}"
                raise errors.HopelessRunError(text)
    environment = RunEnvironment(
        packages=package_versions(),
        machine=machine_facts(),
        workers=workers,
        started=started.isoformat(timespec="seconds"),
        wall_s=round(time.monotonic() - clock, 3),
    )
    in_order = tuple(records[spec] for spec in specs)
    name = run_name(header) if directory is None else directory.resolve().name
    run = make_run(header, environment, in_order, name, directory)
    if directory is not None:
        write_actions(in_order, directory)
    return run


def package_versions() -> dict[str, str]:
    """Return the versions of the packages that a run's numbers may depend on."""
    return installed_versions(PACKAGES)


def play_run(
    setup: PolicySetup, opened: Journal | Run, engine: Engine, callbacks: Callbacks
) -> Run:
    """Play the episodes that are missing, and keep the facts of the run in its directory.

    The callbacks also receive the episodes that are already done. A finished run is returned
    unchanged.
    """
    if isinstance(opened, Run):
        callbacks.note(f"{opened.directory} contains the finished run: no episode is missing")
        return opened
    callbacks.phase("episodes", len(opened.header.specs()))
    with resumable(opened.directory):
        for record in opened.records.values():
            callbacks.episode(record)
        run = play_missing(setup, opened, engine, callbacks.episode)
        if run.directory is None:
            return run
        content = run_json(run)
        # A directory with it holds a finished run.
        files.write_file(run.directory / files.RUN_FILE, content)
    opened.remove()
    return replace(run, content=content)


@contextmanager
def resumable(directory: Path | None) -> Iterator[None]:
    """Tell the user of an interrupted run how to continue it, or how to replace it.

    A file that cannot be written, as on a full disk, interrupts one too.
    """
    advice = changed = "Nothing is kept: a run with an output directory could be resumed."
    repeat = "Correct the policy and repeat"
    if directory is not None:
        kept = f"What is done is kept in {directory}"
        advice = f"{kept}; the same command with --resume continues."
        changed = f"{kept}: --resume continues with the old file, --fresh begins again with the "
        changed += "new one."
        repeat += " the command with --fresh; or --resume plays this same policy on"
    try:
        yield
    except errors.HopelessRunError as error:
        raise errors.HopelessRunError(f"{error}\n{repeat}") from error
    except errors.CheckpointChangedError as error:
        raise errors.CheckpointChangedError(f"{error}\n{changed}") from error
    except errors.OutOfMemoryError as error:
        raise errors.OutOfMemoryError(f"{error}\n{advice}") from error
    except (errors.InfrastructureError, errors.RunDirectoryError) as error:
        raise errors.InfrastructureError(f"{error}\n{advice}") from error
    except KeyboardInterrupt as error:
        raise errors.InterruptedRunError(f"interrupted\n{advice}") from error


# A dataset


def record_episodes(
    setup: PolicySetup, specs: list[EpisodeSpec], directory: Path, callbacks: Callbacks
) -> int:
    """Record a policy's episodes of one task; the directory appears when the dataset is complete.

    Returns how many episodes end with a fault of the policy; such an episode is truncated.

    Raises:
        MissingExtraError: Minari is not installed.
        RunDirectoryError: the directory is there already, or cannot be written.
    """
    minari = require_minari()
    storages = require("minari.dataset.minari_storage", "data")
    task = specs[0].task
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", setup.policy.name).strip("-") or "policy"
    faults = 0
    with (
        _new_directory(directory) as folder,
        contextlib.closing(MiniTouchEnv(task)) as environment,
        contextlib.closing(EpisodeRunner(setup)) as runner,
    ):
        storage = storages.MinariStorage.new(
            folder,
            environment.observation_space,
            environment.action_space,
            jpeg_encoding=False,  # pictures as they are
        )
        callbacks.phase("recording", len(specs))
        for spec in specs:
            played = runner.run(spec)
            if len(played.trace.actions):  # none where the policy failed at the reset
                storage.update_episodes([_episode(environment, played)])
            callbacks.episode(played)
            faults += played.outcome is Outcome.POLICY_FAULT
        storage.update_metadata(
            {
                "dataset_id": f"minitouch/{task}/{name}-v0",
                "minari_version": minari.__version__,
                "algorithm_name": setup.policy.name,
            }
        )
    return faults


@contextlib.contextmanager
def _new_directory(directory: Path) -> Iterator[Path]:
    """Give a path beside a new directory; what is written there becomes it when the block ends.

    What a killed process left there is removed.
    """
    if directory.exists():
        raise errors.RunDirectoryError(f"{directory} is there already; choose another --output")
    directory = directory.absolute()  # Minari joins a relative path to itself
    folder = directory.with_name(f".{directory.name}.unfinished")
    unfinished = folder / directory.name
    try:
        with (
            files.os_errors_as(errors.RunDirectoryError, directory, "written"),
            files.lock_directory(folder),
            contextlib.ExitStack() as stack,
        ):
            shutil.rmtree(unfinished, ignore_errors=True)
            stack.callback(shutil.rmtree, unfinished, ignore_errors=True)
            yield unfinished
            unfinished.rename(directory)
    finally:
        with contextlib.suppress(OSError):  # another process works there
            folder.rmdir()


def _episode(environment: MiniTouchEnv, played: PlayedEpisode) -> Any:
    """Return an episode with its pictures: its actions done again give the same bits."""
    buffers = require("minari.data_collector.episode_buffer", "data")
    spec, trace = played.spec, played.trace
    images = [environment.reset(seed=spec.seed, options={OBJECT: spec.shape})[0]["image"]]
    images += [environment.step(action)[0]["image"] for action in trace.actions]
    last = np.arange(len(trace.actions)) == len(trace.actions) - 1
    terminated = last & (played.outcome in (Outcome.SUCCESS, Outcome.LEFT_WORKSPACE))
    success = last & (played.outcome is Outcome.SUCCESS)
    return buffers.EpisodeBuffer(
        seed=spec.seed,
        observations={"image": np.stack(images), "touch": trace.touch},
        actions=trace.actions,
        rewards=trace.rewards.tolist(),
        terminations=terminated.tolist(),
        truncations=(last & ~terminated).tolist(),
        infos={"is_success": np.concatenate(([False], success))},
    )
