"""Train a learner in a directory, evaluated as it goes under the protocol's own rollout."""

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, replace
from fnmatch import fnmatch
from pathlib import Path

import torch

from minitouch_bench import files
from minitouch_bench.agents.config import TrainingConfig, differing_settings, read_recorded_config
from minitouch_bench.agents.curiosity import digest_method
from minitouch_bench.agents.memory import CHECKPOINT_FILE, IMAGES_FILE
from minitouch_bench.agents.training import ProgressRow, Training
from minitouch_bench.errors import (
    InvalidActionError,
    MiniTouchError,
    MissingExtraError,
    RunDirectoryError,
    UsageError,
)
from minitouch_bench.evaluation.engine import SILENT, Callbacks, Note
from minitouch_bench.evaluation.execution import resumable
from minitouch_bench.json_io import checked, write_toml
from minitouch_bench.machine import require
from minitouch_bench.policies.sources import CONFIG_FILE, EXPLORED_FILE, KEPT_FILE, TRAINED_FILE
from minitouch_bench.processes import keep_freed_memory
from minitouch_bench.reporting.training_page import training_page
from minitouch_bench.text import describe

EVENTS_DIRECTORY = "events"

TRAINING_FILES = (
    CONFIG_FILE, CHECKPOINT_FILE, IMAGES_FILE, files.PROGRESS_FILE, files.REPORT_PAGE,
    EVENTS_DIRECTORY, EXPLORED_FILE, TRAINED_FILE, KEPT_FILE.format("*"),
)  # fmt: skip
"""Patterns of the names in a training's directory."""


@checked
def run_training(
    config: TrainingConfig,
    directory: Path,
    *,
    resume: bool = False,
    fresh: bool = False,
    device: str = "auto",
    trust: bool = False,
    callbacks: Callbacks = SILENT,
) -> bool:
    """Train to the end and return True, or False where it was asked to stop before.

    ``fresh`` removes the training that the directory contains. ``device``: "auto", "cpu" or
    "cuda". ``trust`` permits a method of the user's own, whose source file is the same in a
    resumed training.

    Raises:
        UsageError: no such device, no control steps, senses left out of a phase that the training
            does not have, settings with which the training diverges, both ``resume`` and
            ``fresh``, or an own method without trust or with a fault.
        RunDirectoryError: the directory is in use, is not empty and ``resume`` was not asked for,
            contains another training, or its checkpoint is damaged.
        InfrastructureError: a file cannot be written; the training can be resumed.
    """
    if resume and fresh:
        raise UsageError("choose one of --resume and --fresh")
    _check_phases(config)
    if ":" in config.method and not trust:
        raise UsageError(
            f"'{config.method}' runs Python code of its own on this machine.\n"
            "If you trust it, add --trust"
        )
    chosen = choose_device(device)
    keep_freed_memory()
    with files.lock_directory(directory), _own_settings(chosen), _own_faults(config.method):
        config = replace(config, method_digest=digest_method(config.method))
        known = _check_directory(config, directory, callbacks.note, resume=resume, fresh=fresh)
        callbacks.phase("training", config.steps)
        if config.steps <= config.random_steps and not config.dataset:
            callbacks.note(
                f"nothing is learned: all {config.steps:,} control steps are of the "
                f"{config.random_steps:,} random ones (random_steps)"
            )
        with closing(Training(config, directory, chosen)) as training:
            training.start(fresh=fresh)
            if fresh:  # nothing can be refused any more
                _remove_training(directory)
            with resumable(directory):
                if known is not None and config.is_longer_than(known):
                    _keep_policy(directory, known.steps)
                files.write_file(directory / CONFIG_FILE, write_toml(config))
                with _events_written(directory, callbacks) as watched:
                    return _run(training, directory, watched)


def _check_phases(config: TrainingConfig) -> None:
    """Refuse a training without control steps, or with senses of a phase that it does not have."""
    if not config.steps:
        raise UsageError(
            "both phases have 0 control steps, so that nothing would be learned: give "
            "--exploration-steps or --task-steps"
        )
    if config.exploration.without != config.task_phase.without:
        if not config.task_phase.steps:
            raise UsageError("--task-without needs a task phase, which this training has not")
        if config.exploration.without and not config.exploration_steps:
            raise UsageError(
                "[exploration] without needs an exploration, which this training has not"
            )


def _run(training: Training, directory: Path, callbacks: Callbacks) -> bool:
    """Run a training, and draw its rows if there are any; False where it was asked to stop."""
    try:
        finished = training.run(callbacks)
    except InvalidActionError as error:
        raise UsageError(
            f"the training diverged after step {training.step}: {error}.\n"
            "Set a smaller learning_rate or reward_scale, and another --output"
        ) from error
    if (directory / files.PROGRESS_FILE).exists():
        files.write_file(directory / files.REPORT_PAGE, training_page(directory))
    return finished


@contextmanager
def _own_faults(method: str) -> Iterator[None]:
    """Convert whatever a method of the user's own raises in the block to a ``UsageError``."""
    try:
        yield
    except (MiniTouchError, KeyboardInterrupt):
        raise
    except BaseException as error:  # SystemExit, too
        if ":" not in method:
            raise
        raise UsageError(f"the method {method} failed: {describe(error)}") from error


@contextmanager
def _own_settings(device: torch.device) -> Iterator[None]:
    """Let torch compute on one thread, in float32 and with gradients, whatever the caller set."""
    threads, dtype = torch.get_num_threads(), torch.get_default_dtype()
    precision, cudnn = torch.get_float32_matmul_precision(), torch.backends.cudnn
    of_cudnn = cudnn.deterministic, cudnn.benchmark
    try:
        if device.type == "cuda":
            cudnn.deterministic, cudnn.benchmark = True, False
            torch.set_float32_matmul_precision("high")
        torch.set_num_threads(1)  # more change the last bits, and are slower beside a simulator
        torch.set_default_dtype(torch.float32)
        with torch.inference_mode(False):  # also ends no_grad of the caller
            yield
    finally:
        cudnn.deterministic, cudnn.benchmark = of_cudnn
        torch.set_float32_matmul_precision(precision)
        torch.set_num_threads(threads)
        torch.set_default_dtype(dtype)


@contextmanager
def _events_written(directory: Path, callbacks: Callbacks) -> Iterator[Callbacks]:
    """Give callbacks that also write each row as TensorBoard's events, if it can be written.

    tensorboardX's ``SummaryWriter`` writes in a thread, which ends with a traceback and leaves the
    training waiting where the disk is full; the writer below it has none.

    Raises:
        RunDirectoryError: the disk is full, or the folder of events is another one's.
    """
    try:
        writers = require("tensorboardX.event_file_writer", "train")
        event_proto = require("tensorboardX.proto.event_pb2", "train")
        summary_proto = require("tensorboardX.proto.summary_pb2", "train")
    except MissingExtraError as error:
        callbacks.note(f"no TensorBoard events are written: {error}")
        yield callbacks
        return
    folder = files.make_folder(directory / EVENTS_DIRECTORY).absolute()
    with files.os_errors_as(RunDirectoryError, folder, "written"):
        writer = writers.EventsWriter(str(folder / "events"))

    def write(row: ProgressRow) -> None:
        callbacks.row(row)
        scalars = [
            summary_proto.Summary.Value(tag=f"{row.phase}/{name}", simple_value=value)
            for name, value in asdict(row).items()
            if name != "step" and isinstance(value, float | int)
        ]
        summary = summary_proto.Summary(value=scalars)
        with files.os_errors_as(RunDirectoryError, folder, "written"):
            writer.write_event(
                event_proto.Event(wall_time=time.time(), step=row.step, summary=summary)
            )
            writer.flush()

    try:
        yield replace(callbacks, row=write)
    finally:
        with suppress(OSError):  # every row is in the file already
            writer.close()


def choose_device(name: str) -> torch.device:
    """Return the device called ``name``; "auto" prefers a GPU.

    Raises:
        UsageError: there is none of that name here.
    """
    found = torch.cuda.is_available()
    if name not in ("auto", "cpu", "cuda") or (name == "cuda" and not found):
        raise UsageError(f"no device '{name}' here; choose auto, cpu" + ", cuda" * found)
    if name == "cpu" or not found:
        return torch.device("cpu")
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # equal sums in every run
    return torch.device("cuda")


def _check_directory(
    config: TrainingConfig, directory: Path, note: Note, *, resume: bool, fresh: bool
) -> TrainingConfig | None:
    """See that a directory is empty, or that the training in it is the one to resume or replace.

    Returns the settings of the training to resume, None where there is none.

    Raises:
        RunDirectoryError: the directory contains anything and neither ``resume`` nor ``fresh`` was
            asked for; it contains no training; to resume, one with other settings, or a finished
            one without its checkpoint; to replace, another file beside it.
    """
    entries = files.entries_of(directory)
    is_training = CONFIG_FILE in entries
    if is_training and resume:
        return _check_same(config, directory, is_over=TRAINED_FILE in entries)
    if is_training and fresh:
        entries = [n for n in entries if not any(fnmatch(n, one) for one in TRAINING_FILES)]
        advice = "That is not of the training: move it away, or choose another --output"
    elif is_training:
        advice = "Continue the training in it with --resume, replace it with --fresh, or choose "
        advice += "another --output"
    else:
        advice = "It contains no training; choose another --output"
    files.refuse_entries(directory, entries, advice)
    if resume:
        note(f"{directory} contains no training yet: one is started")
    return None


def _check_same(config: TrainingConfig, directory: Path, *, is_over: bool) -> TrainingConfig:
    """Return the settings of the training to resume.

    Raises:
        RunDirectoryError: they are others, or the training ``is_over`` and has no checkpoint.
    """
    known = read_recorded_config(directory / CONFIG_FILE)
    if config != known and not config.is_longer_than(known):
        raise RunDirectoryError(
            f"{directory / CONFIG_FILE} has other settings: "
            f"{'; '.join(differing_settings(known, config)[:3])}.\n"
            "Resume with the same ones or more steps in the last phase, or begin again with "
            "--fresh or another --output"
        )
    if is_over and not os.path.lexists(directory / CHECKPOINT_FILE):
        raise RunDirectoryError(
            f"{directory} has a finished training without its checkpoint: it cannot go on.\n"
            "Replace it with --fresh, or choose another --output"
        )
    return known


def _remove_training(directory: Path) -> None:
    """Remove what a training has written into its directory."""
    with files.os_errors_as(RunDirectoryError, directory, "cleared"):
        # Without its settings no training would be known in what an interruption leaves.
        names = sorted(files.entries_of(directory), key=lambda name: name == CONFIG_FILE)
        for file in [directory / name for name in names]:
            if file.name == EVENTS_DIRECTORY and files.is_folder(file):
                shutil.rmtree(file)
            else:
                file.unlink()


def _keep_policy(directory: Path, steps: int) -> None:
    """Name the policy of a training that is made longer by its steps: it is no longer the last."""
    file = directory / TRAINED_FILE
    with files.os_errors_as(RunDirectoryError, file, "renamed"), suppress(FileNotFoundError):
        file.rename(file.with_name(KEPT_FILE.format(steps)))
