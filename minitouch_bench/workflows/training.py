"""Train a learner in a directory, evaluated as it goes under the protocol's own rollout."""

import os
import socket
import struct
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from minitouch_bench import files
from minitouch_bench.agents.checkpoint import CHECKPOINT_FILE, PICTURES_FILE
from minitouch_bench.agents.config import CONFIG_FILE, TrainingConfig, read_config
from minitouch_bench.agents.progress import Evaluation, ProgressRow
from minitouch_bench.agents.training import Training, TrainingCallbacks
from minitouch_bench.documents import write_toml
from minitouch_bench.errors import (
    InfrastructureError,
    InvalidActionError,
    MissingExtraError,
    RunDirectoryError,
    UsageError,
)
from minitouch_bench.evaluation.actors import PolicyActor
from minitouch_bench.evaluation.engine import Note
from minitouch_bench.evaluation.rollout import run_episode
from minitouch_bench.optional import require
from minitouch_bench.policies.native import NativePolicy
from minitouch_bench.policies.networks import TouchActor
from minitouch_bench.policies.sources import KEPT_FILE, TRAINED_FILE
from minitouch_bench.processes import keep_freed_memory
from minitouch_bench.records import Outcome
from minitouch_bench.reporting.training_page import training_page
from minitouch_bench.runs.plan import Suite
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.workflows import UNSEEN, TrainingProgress

EVALUATION_SUITE = "training"
"""Seeds the episodes of a training's evaluations; no suite has this name."""

EVENTS_DIRECTORY = "events"


def run_training(
    config: TrainingConfig,
    directory: Path,
    *,
    resume: bool = False,
    device: str = "auto",
    callbacks: TrainingProgress = UNSEEN,
) -> bool:
    """Train to the end and return True, or False where it was asked to stop before.

    ``device``: "auto", "cpu" or "cuda".

    Raises:
        UsageError: no such device, or settings with which the training diverges.
        RunDirectoryError: the directory is in use, holds another training, or its
            checkpoint is damaged.
        InfrastructureError: a file cannot be written; the training can be resumed.
    """
    chosen = choose_device(device)
    keep_freed_memory()
    torch.set_num_threads(1)  # more change the last bits, and are slower beside a simulator
    with files.lock_directory(directory):
        _prepare(config, directory, resume, callbacks.note)
        environment = MiniTouchEnv(
            config.task, config.objects or None, max_steps=config.episode_steps or None
        )
        evaluator = TrainingEvaluator(config)
        events = _open_events(directory, callbacks.note)

        def on_row(row: ProgressRow) -> None:
            callbacks.row(row)
            if events is not None:
                events.add(row)

        watched = TrainingCallbacks(evaluator.evaluate, on_row, callbacks.should_stop)
        try:
            training = Training(config, environment, directory, watched, chosen)
            training.start()
            finished = _run(training, directory)
        finally:
            evaluator.close()
            environment.close()
        if (directory / files.PROGRESS_FILE).exists():  # there is a row to draw
            files.write_file(directory / files.REPORT_PAGE, training_page(directory))
    return finished


def _run(training: Training, directory: Path) -> bool:
    """Train; where a file cannot be written, say what is kept and how to go on.

    Raises:
        InfrastructureError: a file cannot be written.
        UsageError: the networks no longer give numbers.
    """
    try:
        return training.run()
    except InvalidActionError as error:
        raise UsageError(
            f"the training diverged after step {training.step}: {error}.\n"
            "Set a smaller learning_rate or reward_scale, and another --output"
        ) from error
    except RunDirectoryError as error:
        kept = training.kept_step
        if kept is None:
            advice = "There is no checkpoint yet; the same command with --resume begins again"
        else:
            advice = (
                f"The checkpoint of step {kept} is kept in {directory}; once there is room, the "
                "same command with --resume continues"
            )
        raise InfrastructureError(f"{error}\n{advice}") from error


class _Events:
    """TensorBoard's events of one training, each written when it happens.

    tensorboardX's own writer opens its file through links, and its thread ends with a traceback
    where the disk is full; its protocol buffers and check sums are used here.
    """

    def __init__(self, folder: Path) -> None:
        events = require("tensorboardX.proto.event_pb2", "train")
        summary = require("tensorboardX.proto.summary_pb2", "train")
        self._event, self._summary = events.Event, summary.Summary
        self._checksum = require("tensorboardX.record_writer", "train").masked_crc32c
        name = f"events.out.tfevents.{time.time():.0f}.{socket.gethostname()}"
        self._file = files.make_folder(folder) / name
        self._write(file_version="brain.Event:2")

    def add(self, row: ProgressRow) -> None:
        """Write every number of a row as a scalar at its control step."""
        scalars = [
            self._summary.Value(tag=f"{row.phase}/{name}", simple_value=value)
            for name, value in asdict(row).items()
            if name != "step" and isinstance(value, float | int)
        ]
        self._write(step=row.step, summary=self._summary(value=scalars))

    def _write(self, **fields: Any) -> None:
        """Add an event in the form of TFRecord: length, content, a check sum after each."""
        content = self._event(wall_time=time.time(), **fields).SerializeToString()
        length = struct.pack("<Q", len(content))
        parts = (length, self._sum(length), content, self._sum(content))
        files.append_bytes(self._file, b"".join(parts))

    def _sum(self, content: bytes) -> bytes:
        return struct.pack("<I", self._checksum(content))


def _open_events(directory: Path, note: Note) -> _Events | None:
    """Return the writer of a new file of events, None where its package is not installed."""
    try:
        return _Events(directory / EVENTS_DIRECTORY)
    except MissingExtraError as error:
        note(f"no TensorBoard events are written: {error}")
        return None


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
    torch.backends.cudnn.deterministic = True
    torch.backends.cudnn.benchmark = False
    torch.set_float32_matmul_precision("high")
    return torch.device("cuda")


def _prepare(config: TrainingConfig, directory: Path, resume: bool, note: Note) -> None:
    """Write the settings of a new or longer training, or check those of one to resume."""
    file = directory / CONFIG_FILE
    for name in (PICTURES_FILE, files.PROGRESS_FILE):
        if os.path.lexists(directory / name):
            with files.os_errors_as(RunDirectoryError, directory / name, "written"):
                os.close(files.open_plain(directory / name, os.O_RDWR))
    if resume and not os.path.lexists(file):
        note(f"{directory} contains no training yet: one is started")
    if any(os.path.lexists(directory / name) for name in (CHECKPOINT_FILE, files.PROGRESS_FILE)):
        if not resume:
            raise RunDirectoryError(
                f"{directory} contains a training: continue it with --resume, or choose another "
                "--output"
            )
        known = read_config(file, config)
        if config.is_longer_than(known):
            _keep_policy(directory / TRAINED_FILE, known.steps)
        elif config != known:
            raise RunDirectoryError(
                f"{file} has other settings than asked for; resume with the same ones, or with "
                "more steps in the last phase"
            )
    files.write_file(file, write_toml(config))


def _keep_policy(file: Path, steps: int) -> None:
    """Name the policy of a training that is made longer by its steps: it is no longer the last."""
    if os.path.lexists(file):
        with files.os_errors_as(RunDirectoryError, file, "renamed"):
            file.rename(file.with_name(KEPT_FILE.format(steps)))


class TrainingEvaluator:
    """Evaluate policies on the same few episodes each time, in a world of their own."""

    def __init__(self, config: TrainingConfig) -> None:
        suite = Suite(
            EVALUATION_SUITE,
            (config.task,),
            config.evaluate_episodes,
            rankable=False,
            seed=config.seed,
        )
        self._specs = suite.episodes(exploration=False)
        self._environment = MiniTouchEnv(config.task, None)

    def evaluate(self, actor: TouchActor, deterministic: bool) -> Evaluation:
        """Return the shares of success and touch over the episodes."""
        records = [
            run_episode(self._environment, PolicyActor(NativePolicy(actor, deterministic)), spec)
            for spec in self._specs
        ]
        touched = np.concatenate([record.trace.contact_ticks > 0 for record in records])
        success = np.mean([record.outcome is Outcome.SUCCESS for record in records])
        return Evaluation(float(success), float(touched.mean()))

    def close(self) -> None:
        """Free the world."""
        self._environment.close()
