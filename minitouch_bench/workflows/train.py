"""Train a learner: the command ``train``."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import typer

from minitouch_bench.agents import METHODS
from minitouch_bench.errors import InterruptedRunError
from minitouch_bench.files import REPORTS
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.workflows import UNSEEN, TrainingProgress
from minitouch_bench.workflows.options import StrPath

TRAININGS = REPORTS / "training"


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
        preset: default (what learns best here) or paper (values of the supplement).
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
