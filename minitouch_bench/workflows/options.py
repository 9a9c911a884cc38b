"""The parameters that several workflows share: in Python, and as options of a command."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

import typer

from minitouch_bench.documents import read_toml
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.engine import ENGINES, STUDY_ENGINES, EngineOptions
from minitouch_bench.policies.formats import BUILT_IN, KIND_BY_SUFFIX
from minitouch_bench.policies.isolation.options import Isolation, IsolationOptions
from minitouch_bench.policies.limits import PolicyLimits
from minitouch_bench.protocol.minitouch import ACT_TIMEOUT_S, EPISODE_TIMEOUT_S

StrPath = str | PathLike[str]
MAX_WORKERS = 1024
MAX_ACT_TIMEOUT_S = 86400.0
AUTO = "auto"


@dataclass(frozen=True)
class OnCommandLine:
    """How a parameter is given on the command line where that differs from Python.

    ``kind``: its type there. ``option``: Typer's argument or option. ``default``: in place of
    Python's.
    """

    kind: Any
    option: Any
    default: Any = ...


def words_option(**settings: Any) -> OnCommandLine:
    """Describe a list that is one text with commas on the command line."""
    return OnCommandLine(str | None, episodes_option(**settings), None)


episodes_option = partial(typer.Option, rich_help_panel="Episodes")
output_option = partial(typer.Option, rich_help_panel="Output")
engine_option = partial(typer.Option, rich_help_panel="Engine")
isolation_option = partial(typer.Option, rich_help_panel="Isolation")
"""Options of a group in a command's help."""

POLICIES = (
    f"{', '.join(BUILT_IN)}, a checkpoint ({' '.join(KIND_BY_SUFFIX)}), a directory with one "
    "file per task, package.module:attribute, http://..., or hf://USER/REPO/FILE@REVISION"
)

Policy = Annotated[object, OnCommandLine(str, typer.Argument(metavar="POLICY", help=POLICIES))]
Exploration = Annotated[
    object | None,
    OnCommandLine(
        str | None, episodes_option(help="The policy as of the end of the exploration phase.")
    ),
]
Workers = Annotated[
    int | str | None,
    OnCommandLine(
        str, engine_option(metavar="N|auto", help="Worker processes; auto: one per core."), "auto"
    ),
]
WorkersText = Annotated[
    str, engine_option(metavar="N|auto", help="Worker processes; auto: one per core.")
]
ExplorationText = Annotated[
    str | None, episodes_option(help="The policy as of the end of the exploration phase.")
]
IsolationText = Annotated[
    Isolation, isolation_option(help="See docs/explanation/isolation.md; none needs --trust.")
]


def _engine_names(names: Iterable[str]) -> Any:
    about = "; ".join(f"{name}: {ENGINES[name].about}" for name in names)
    return engine_option(metavar="|".join(names), help=f"{about}.")


EngineName = Annotated[str, _engine_names(ENGINES)]
StudyEngine = Annotated[str, _engine_names(STUDY_ENGINES)]
Address = Annotated[
    str | None,
    engine_option(
        metavar="HOST:PORT",
        help="; ".join(f"{n}: {one.address}" for n, one in ENGINES.items() if one.address) + ".",
    ),
]
IsolationLevel = Annotated[
    str,
    OnCommandLine(
        Isolation,
        isolation_option(help="See docs/explanation/isolation.md; none needs --trust."),
        Isolation.SANDBOX,
    ),
]
Trust = Annotated[
    bool, isolation_option("--trust", help="Run a policy's own Python code on this machine.")
]
ActTimeout = Annotated[
    float,
    isolation_option(
        min=0.01, max=MAX_ACT_TIMEOUT_S, help="Seconds a policy may take for one action."
    ),
]
EpisodeTimeout = Annotated[
    float,
    isolation_option(
        min=0.01,
        max=MAX_ACT_TIMEOUT_S,
        help="Seconds a policy may take in an episode; another number is unofficial.",
    ),
]
Resume = Annotated[bool, output_option("--resume", help="Continue the run there.")]
Fresh = Annotated[bool, output_option("--fresh", help="Replace the run there.")]


def _take_config(context: typer.Context, path: Path | None) -> None:
    """Take the options that are not on the command line from a file."""
    if path is None or context.resilient_parsing:
        return
    parameters = {_long_name(one): one for one in context.command.params}
    given = _read_config(path, parameters.keys() - {"config", "help"})
    context.default_map = {
        str(parameters[name].name): value
        if not isinstance(value, list) or parameters[name].multiple
        else ",".join(value)
        for name, value in given.items()
    }


def _read_config(path: Path, names: Iterable[str]) -> dict[str, str | bool | list[str]]:
    """Return the options in a file by name; ``names`` are those that it may have.

    A hyphen in a name is an underscore. Numbers come back as the text that a user would type.

    Raises:
        UsageError: it is not readable, or an option does not exist or has no such value.
    """
    table = read_toml(path)
    known = {*names} - {"trust"}
    found: dict[str, str | bool | list[str]] = {}
    for key, value in table.items():
        name = key.replace("-", "_")
        if name == "trust":
            raise UsageError(f"{path}: trust is given on the command line alone: add --trust")
        if name not in known:
            listed = ", ".join(sorted(known))
            raise UsageError(f"{path} has no use for '{key}'; its names are {listed}")
        found[name] = _as_typed(path, key, value)
    return found


def _as_typed(path: Path, key: str, value: object) -> str | bool | list[str]:
    if isinstance(value, bool):
        return value
    if isinstance(value, list) and all(isinstance(one, str | int) for one in value):
        return [str(one) for one in value]
    if isinstance(value, str | int | float):
        return str(value)
    raise UsageError(f"{path}: '{key}' is no text, number, true or false, or list of them")


def _long_name(parameter: Any) -> str:
    """Return a parameter's name on the command line, with underscores."""
    longest = max(parameter.opts, key=len)
    return str(longest).lstrip("-").replace("-", "_")


Config = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        callback=_take_config,
        is_eager=True,
        help="Options from a TOML file; those on the command line win.",
    ),
]
RunDirectory = Annotated[
    StrPath,
    OnCommandLine(Path, typer.Argument(metavar="RUN", help="Directory of a finished run.")),
]
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


def words(given: str | Sequence[str] | None) -> tuple[str, ...]:
    """Return the words of a list, or of a text with commas, in order."""
    listed = given.split(",") if isinstance(given, str) else given or ()
    return tuple(word.strip() for word in listed if word.strip())


def whole_numbers(option: str, text: str) -> tuple[int, ...]:
    """Return the whole numbers of a list.

    Raises:
        UsageError: one of its words is no such number.
    """
    numbers = words(text)
    for word in numbers:
        if not re.fullmatch("[0-9]{1,15}", word):
            raise UsageError(f"{option} is a list of whole numbers, not '{word}'")
    return tuple(map(int, numbers))
