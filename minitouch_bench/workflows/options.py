"""The options that several commands share, and how their values are read."""

import re
from collections.abc import Iterable, Sequence
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.engine import ENGINES, EngineOptions
from minitouch_bench.policies.isolation.options import (
    MAX_TIMEOUT_S,
    Isolation,
    IsolationOptions,
    PolicyLimits,
)
from minitouch_bench.policies.loaders import BUILT_IN, KIND_BY_SUFFIX
from minitouch_bench.protocol.minitouch import ACT_TIMEOUT_S, EPISODE_TIMEOUT_S, TASK_NAMES

StrPath = str | PathLike[str]
Words = str | Sequence[str]
"""A list, or a text with commas."""

MAX_WORKERS = 1024
AUTO = "auto"

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
        help="; ".join(f"{name}: {engine.about}" for name, engine in ENGINES.items()) + ".",
    ),
]
Address = Annotated[
    str | None,
    engine_option(
        metavar="HOST:PORT",
        help="; ".join(f"{name}: {e.address}" for name, e in ENGINES.items() if e.address) + ".",
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


def engine_options(engine: str, workers: int | str | None, address: str | None) -> EngineOptions:
    """Return the engine asked for; None and "auto" stand for one worker per core.

    Raises:
        UsageError: it is not such a number of workers.
    """
    if workers in (None, AUTO):
        return EngineOptions(engine, None, address)
    text = str(workers)
    if not text.isdecimal() or not 1 <= int(text) <= MAX_WORKERS:
        raise UsageError(f"--workers is a number from 1 to {MAX_WORKERS}, or auto, not '{text}'")
    return EngineOptions(engine, int(text), address)


def isolation_options(
    isolation: str,
    trust: bool,
    act_timeout: float = ACT_TIMEOUT_S,
    episode_timeout: float = EPISODE_TIMEOUT_S,
) -> IsolationOptions:
    """Return how to isolate a policy.

    Raises:
        UsageError: there is no such level, or a time cannot be waited for.
    """
    if isolation not in tuple(Isolation):
        raise UsageError(f"no isolation '{isolation}'; it is one of {', '.join(Isolation)}")
    limits = PolicyLimits(act_timeout_s=act_timeout, episode_timeout_s=episode_timeout)
    return IsolationOptions(Isolation(isolation), trust, limits)


def words(given: Iterable[object] | None) -> tuple[str, ...]:
    """Return the words of a list, or of a text with commas, in order."""
    listed = given.split(",") if isinstance(given, str) else given or ()
    return tuple(word for one in listed if (word := str(one).strip()))


def whole_numbers(option: str, given: str | None) -> tuple[int, ...]:
    """Return the whole numbers of a text with commas.

    Raises:
        UsageError: one of its words is not a whole number.
    """
    numbers = words(given)
    for word in numbers:
        if not re.fullmatch("[0-9]{1,15}", word):
            raise UsageError(f"{option} is a list of whole numbers, not '{word}'")
    return tuple(map(int, numbers))
