"""The command ``train``: train a learner in two phases."""

from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.agents import METHODS
from minitouch_bench.cli import options
from minitouch_bench.perturbation import SENSES


def train(
    task: options.TaskArgument,
    *,
    method: Annotated[
        str | None,
        typer.Option(
            help=f"{', '.join(METHODS)}, or package.module:Class of your own; by default hac."
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(metavar="N", min=0, help="Seed of every random number; by default 0."),
    ] = None,
    exploration_steps: Annotated[
        int | None,
        typer.Option(metavar="N", min=0, help="Control steps on the intrinsic reward alone."),
    ] = None,
    task_steps: Annotated[
        int | None,
        typer.Option(metavar="N", min=0, help="Control steps on the task's reward afterwards."),
    ] = None,
    objects: Annotated[
        str | None,
        typer.Option(
            help="cube, shapes (train, held-out, all) or the folder of a shape set; by default the "
            "task's. A policy that was trained on held-out shapes cannot "
            "show generalization on novel-shapes."
        ),
    ] = None,
    without: Annotated[
        str | None,
        typer.Option(
            metavar="A,B",
            help=f"Senses that the policy learns without: {', '.join(SENSES)}. Curiosity has them.",
        ),
    ] = None,
    task_without: Annotated[
        str | None,
        typer.Option(
            metavar="A,B",
            help="The same for the task phase alone: the exploration policy keeps these senses.",
        ),
    ] = None,
    from_log: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Dataset (Minari's format) to explore in place of the simulator.",
        ),
    ] = None,
    preset: Annotated[
        str,
        typer.Option(help="default (chosen by trials) or paper (values of the supplement)."),
    ] = "default",
    config: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="TOML file of settings: see docs/reference/training-settings.md.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="By default reports/training/TASK-METHOD[-no-SENSE]-SEED.",
        ),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue from the checkpoint.")] = False,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Replace the training in the directory.")
    ] = False,
    device: Annotated[
        str, typer.Option(help="auto (a GPU if there is one), cpu or cuda.")
    ] = "auto",
    trust: Annotated[
        bool, typer.Option("--trust", help="Run a method's own Python code on this machine.")
    ] = False,
) -> None:
    """Train a learner in two phases: curiosity alone, then the task."""
    from minitouch_bench import api

    directory = api.train(
        task,
        method,
        seed=seed,
        exploration_steps=exploration_steps,
        task_steps=task_steps,
        objects=objects,
        without=without,
        task_without=task_without,
        from_log=from_log,
        preset=preset,
        config=config,
        output=output,
        resume=resume,
        fresh=fresh,
        device=device,
        trust=trust,
        progress=True,
    )
    print(directory)
