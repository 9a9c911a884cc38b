"""Train a learner: the command ``train``, and ``minitouch_bench.train``."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import typer

from minitouch_bench.agents import METHODS
from minitouch_bench.errors import InterruptedRunError
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.workflows import UNSEEN, TrainingProgress
from minitouch_bench.workflows.options import OnCommandLine, StrPath


def train(
    task: Annotated[str, typer.Argument(metavar="TASK", help=", ".join(TASK_NAMES))],
    method: Annotated[
        str | None, typer.Option(help=f"{', '.join(METHODS)}; by default hac.")
    ] = None,
    *,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Fixes every random draw; by default 0.")
    ] = None,
    exploration_steps: Annotated[
        int | None, typer.Option(min=0, help="Control steps on the intrinsic reward alone.")
    ] = None,
    task_steps: Annotated[
        int | None, typer.Option(min=0, help="Control steps on the task's reward after them.")
    ] = None,
    objects: Annotated[
        str | None,
        typer.Option(help="cube, or shapes to draw from: train, all. Default: the task's."),
    ] = None,
    from_log: Annotated[
        StrPath | None,
        OnCommandLine(
            Path | None,
            typer.Option(help="Explore this recorded dataset (Minari's), not the simulator."),
        ),
    ] = None,
    preset: Annotated[
        str, typer.Option(help="default (what learns best here) or paper (Tables 2 and 3).")
    ] = "default",
    config: Annotated[
        StrPath | None,
        OnCommandLine(
            Path | None,
            typer.Option(help="A TOML file of settings: see docs/reference/training-settings.md."),
        ),
    ] = None,
    settings: Mapping[str, Any] = MappingProxyType({}),
    output: Annotated[
        StrPath | None,
        OnCommandLine(
            Path | None, typer.Option(help="By default reports/training/TASK-METHOD-SEED.")
        ),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the checkpoint.")] = False,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    callbacks: TrainingProgress = UNSEEN,
) -> Path:
    """Train a learner in two phases: curiosity alone, then the task.

    Returns the training's directory, which ``evaluate`` takes as a policy. ``settings`` change the
    preset's, nested as in the TOML file: ``{"task_phase": {"steps": 80_000}}``.

    Raises:
        MiniTouchError: what is wrong and what to do; see ``minitouch_bench.errors``.
    """
    # Not at the top: torch takes seconds, and --help shall not.
    from minitouch_bench.agents.config import apply_settings, make_config
    from minitouch_bench.workflows.training import TrainingRequest, default_directory, run_training

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
    directory = default_directory(asked) if output is None else Path(output)
    callbacks.begin(asked.steps)
    if not run_training(TrainingRequest(asked, directory, resume, device, callbacks)):
        raise InterruptedRunError(
            f"interrupted; what is learned is kept in {directory}, and the same command with "
            "--resume continues"
        )
    return directory
