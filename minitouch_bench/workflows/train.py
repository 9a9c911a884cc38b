"""Train a learner, or a grid of them: the commands ``train`` and ``study``."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from minitouch_bench.agents import METHODS
from minitouch_bench.errors import InterruptedRunError
from minitouch_bench.files import REPORTS
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.workflows import (
    UNSEEN,
    UNSEEN_STUDY,
    StudyProgress,
    TrainingProgress,
    options,
)
from minitouch_bench.workflows.options import StrPath, Words

if TYPE_CHECKING:
    from minitouch_bench.reporting.study import StudyResults

TRAININGS, STUDIES = REPORTS / "training", REPORTS / "studies"


def train(
    task: Annotated[str, typer.Argument(metavar="TASK", help=", ".join(TASK_NAMES))],
    method: Annotated[
        str | None, typer.Option(help=f"{', '.join(METHODS)}; by default hac.")
    ] = None,
    *,
    seed: Annotated[int | None, typer.Option(min=0)] = None,
    exploration_steps: Annotated[int | None, typer.Option(min=0)] = None,
    task_steps: Annotated[int | None, typer.Option(min=0)] = None,
    objects: Annotated[str | None, typer.Option()] = None,
    from_log: Annotated[StrPath | None, typer.Option()] = None,
    preset: Annotated[str, typer.Option()] = "default",
    config: Annotated[StrPath | None, typer.Option()] = None,
    settings: Mapping[str, Any] = MappingProxyType({}),
    output: Annotated[StrPath | None, typer.Option()] = None,
    resume: Annotated[bool, typer.Option()] = False,
    device: Annotated[str, typer.Option()] = "auto",
    callbacks: TrainingProgress = UNSEEN,
) -> Path:
    """Train a learner in two phases: curiosity alone, then the task.

    Returns the training's directory, which ``evaluate`` takes as a policy. ``settings`` change the
    preset's, nested as in the TOML file: ``{"task_phase": {"steps": 80_000}}``.

    Args:
        seed: Seed of every random number; by default 0.
        exploration_steps: Control steps on the intrinsic reward alone.
        task_steps: Control steps on the task's reward afterwards.
        objects: cube, or shapes: train, held-out, all; by default the task's. A policy that was
            trained on held-out shapes cannot show generalization on novel-shapes.
        from_log: Dataset (Minari's format) to explore in place of the simulator.
        preset: default (what learns best here) or paper (Tables 2 and 3).
        config: TOML file of settings: see docs/reference/training-settings.md.
        output: Directory of the training; by default reports/training/TASK-METHOD-SEED.
        resume: Continue from the checkpoint.
        device: auto, cpu or cuda.

    Raises:
        MiniTouchError: what is wrong and what to do; see ``minitouch_bench.errors``.
    """
    # Not at the top: torch takes seconds, and --help shall not.
    from minitouch_bench.agents.config import apply_settings, make_config
    from minitouch_bench.workflows.training import run_training

    given = {
        "method": method,
        "seed": seed,
        "objects": objects,
        "log": None if from_log is None else str(from_log),
        "exploration": None if exploration_steps is None else {"steps": exploration_steps},
        "task_phase": None if task_steps is None else {"steps": task_steps},
    }
    changes = {name: value for name, value in given.items() if value is not None}
    base = make_config(task, preset, None if config is None else Path(config), settings)
    asked = apply_settings(base, changes)
    usual = TRAININGS / f"{asked.task}-{asked.method}-{asked.seed}"
    directory = usual if output is None else Path(output)
    callbacks.begin(asked.steps)
    if not run_training(asked, directory, resume=resume, device=device, callbacks=callbacks):
        raise InterruptedRunError(
            f"interrupted; what is learned is kept in {directory}, and the same command with "
            "--resume continues"
        )
    return directory


def study(
    file: Annotated[StrPath, typer.Argument(metavar="FILE")],
    *,
    tasks: Annotated[Words | None, typer.Option(metavar="A,B")] = None,
    methods: Annotated[Words | None, typer.Option(metavar="A,B")] = None,
    output: Annotated[StrPath | None, typer.Option()] = None,
    workers: options.Workers = 1,
    engine: options.EngineName = "local",
    address: options.Address = None,
    callbacks: StudyProgress = UNSEEN_STUDY,
) -> "StudyResults":
    """Train and evaluate a grid of methods, tasks and seeds; the same command continues it.

    A training that fails is named in the report and does not stop the others; the next start of
    the study tries it again. On the command line such a study ends with exit code 5.

    Args:
        file: The grid: see docs/how-to/studies.md.
        tasks: Only these tasks of the file now; the report has all of them.
        methods: Only these methods of the file now.
        output: The study's directory; by default reports/studies/NAME, after the file.

    Raises:
        UsageError: the file is not readable, or names what does not exist.
        MissingExtraError: Ray or, for the figures, matplotlib is not installed.
        InfrastructureError: no cluster answers.
        RunDirectoryError: the directory is in use, cannot be written, or was started with
            other settings.
    """
    from minitouch_bench.workflows.study_config import read_study
    from minitouch_bench.workflows.studying import run_study

    runs_it = options.engine_options(engine, workers, address)
    config = read_study(Path(file))
    directory = STUDIES / Path(file).stem if output is None else Path(output)
    wanted = config.select(options.words(tasks), options.words(methods))
    callbacks.begin(config, directory, wanted)
    return run_study(config, directory, runs_it, callbacks.state, wanted)
