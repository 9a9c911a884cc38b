"""The command ``train``: train a learner in two phases."""

from pathlib import Path
from typing import Annotated

from minitouch_bench.agents import METHODS
from minitouch_bench.commands import options
from minitouch_bench.commands.options import flag, option
from minitouch_bench.perturbation import SENSES

CHOICE = f"{', '.join(METHODS)}, or package.module:Class of your own; by default hac."
LACKING = f"Senses that the policy learns without: {', '.join(SENSES)}. Curiosity has them."


def train(
    task: options.TaskArgument,
    *,
    method: Annotated[str | None, option("NAME", CHOICE)] = None,
    seed: Annotated[
        int | None, option("N", "Seed of every random number; by default 0.", min=0)
    ] = None,
    exploration_steps: Annotated[
        int | None, option("N", "Control steps on the intrinsic reward alone.", min=0)
    ] = None,
    task_steps: Annotated[
        int | None, option("N", "Control steps on the task's reward afterwards.", min=0)
    ] = None,
    objects: Annotated[
        str | None, option("SET", f"{options.OBJECTS}; by default the task's.")
    ] = None,
    without: Annotated[str | None, option("A,B", LACKING)] = None,
    task_without: Annotated[
        str | None,
        option("A,B", "The same for the task phase alone: exploration keeps these senses."),
    ] = None,
    from_log: Annotated[
        Path | None,
        option("DIR", "Dataset (Minari's format) to explore in place of the simulator."),
    ] = None,
    preset: Annotated[
        str, option("NAME", "default (chosen by trials) or paper (values of the supplement).")
    ] = "default",
    config: Annotated[
        Path | None,
        option("FILE", "TOML file of settings: see docs/reference/training-settings.md."),
    ] = None,
    output: Annotated[
        Path | None, option("DIR", "By default reports/training/TASK-METHOD[-no-SENSE]-SEED.")
    ] = None,
    resume: Annotated[bool, flag("--resume", "Continue from the checkpoint.")] = False,
    fresh: Annotated[bool, flag("--fresh", "Replace the training in the directory.")] = False,
    device: Annotated[str, option("NAME", "auto (a GPU if there is one), cpu or cuda.")] = "auto",
    trust: Annotated[
        bool, flag("--trust", "Run a method's own Python code on this machine.")
    ] = False,
) -> None:
    """Train a learner in two phases: curiosity alone, then the task."""
    arguments = dict(locals())  # the options are named as the arguments of ``api.train``
    from minitouch_bench import api

    print(api.train(**arguments, progress=True))
