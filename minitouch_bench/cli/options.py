"""The options that several commands share, and how their values are read."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.evaluation.engine import ENGINES
from minitouch_bench.perturbation import MAX_TIMEOUT_S
from minitouch_bench.policies.policy import BUILT_IN, KIND_BY_SUFFIX, Isolation
from minitouch_bench.protocol.minitouch import TASK_NAMES

episodes_option = partial(typer.Option, rich_help_panel="Episodes")
output_option = partial(typer.Option, rich_help_panel="Output")
engine_option = partial(typer.Option, rich_help_panel="Engine")
isolation_option = partial(typer.Option, rich_help_panel="Isolation")
timeout_option = partial(isolation_option, metavar="S", min=0.01, max=MAX_TIMEOUT_S)
"""Options of a group in a command's help."""

POLICIES = (
    f"{', '.join(BUILT_IN)}, a checkpoint ({' '.join(KIND_BY_SUFFIX)}), a directory with one "
    "file per task, package.module:attribute, http://..., or hf://USER/REPO/FILE@REVISION"
)

Policy = Annotated[str, typer.Argument(metavar="POLICY", help=POLICIES)]
EXPLORATION = episodes_option(help="The policy at the end of the exploration phase.")
Exploration = Annotated[str | None, EXPLORATION]
RunDirectory = Annotated[Path, typer.Argument(metavar="RUN", help="Directory of a finished run.")]
Runs = Annotated[list[Path], typer.Argument(metavar="RUN", help="Directories of finished runs.")]
Task = Annotated[str, typer.Argument(metavar="TASK", help=", ".join(TASK_NAMES))]
Workers = Annotated[
    str,
    engine_option(metavar="N|auto", help="Worker processes; auto: one per core."),
]
EngineName = Annotated[
    str,
    engine_option(
        metavar="|".join(ENGINES),
        help="; ".join(f"{name}: {where}" for name, where in ENGINES.items()) + ".",
    ),
]
Address = Annotated[
    str | None,
    engine_option(
        metavar="HOST:PORT",
        help="ray: the cluster; without it Ray starts here.",
    ),
]
IsolationLevel = Annotated[
    str,
    isolation_option(
        metavar="|".join(Isolation),
        help="See docs/explanation/isolation.md; none needs --trust.",
    ),
]
Trust = Annotated[
    bool, isolation_option("--trust", help="Run a policy's own Python code on this machine.")
]
ActTimeout = Annotated[
    float, timeout_option(help="Seconds a policy may take for one action; another is unofficial.")
]
EpisodeTimeout = Annotated[
    float, timeout_option(help="Seconds a policy may take in an episode; another is unofficial.")
]
Resume = Annotated[bool, output_option("--resume", help="Continue the run in the directory.")]
Fresh = Annotated[bool, output_option("--fresh", help="Replace the run in the directory.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
