"""How every command parses its options and shows its help, and the options that several share."""

import re
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption

from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.engine import ENGINES
from minitouch_bench.policies.formats import BUILT_IN, KIND_BY_SUFFIX
from minitouch_bench.policies.policy import Isolation
from minitouch_bench.protocol.limits import MAX_TIMEOUT_S
from minitouch_bench.protocol.minitouch import TASK_NAMES


class _Once:
    """A command, or a group of them, that refuses an option which is given twice.

    Otherwise the last value would be used, and the first one lost without a word.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        """Parse the arguments of the command line.

        Raises:
            UsageError: an option that takes one value is given twice.
        """
        parse: Any = super()
        given = [] if ctx.resilient_parsing else parse.make_parser(ctx).parse_args([*args])[2]
        for parameter, count in Counter(given).items():
            if count > 1 and isinstance(parameter, TyperOption) and not parameter.multiple:
                names = " / ".join((*parameter.opts, *parameter.secondary_opts))
                raise UsageError(f"{names} is given {count} times: give it once")
        return parse.parse_args(ctx, args)


class Command(_Once, TyperCommand):
    """A command whose help is plain text, with the groups of its options.

    Typer's help with boxes and colors imports a Markdown parser and a syntax highlighter, which
    takes as long as everything else together.
    """

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, and the options group by group."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            name, meaning = parameter.get_help_record(ctx) or ("", "")
            group = getattr(parameter, "rich_help_panel", None) or "Options"
            if isinstance(parameter, TyperArgument):
                name, group = parameter.display_name_raw, "Arguments"
            groups.setdefault(group, []).append((name, meaning))
        for title, records in groups.items():
            with formatter.section(title):
                formatter.write_dl(records)


def make_group(**about: Any) -> typer.Typer:
    """Return a group of commands, still empty, whose help is plain text as that of a command."""
    return typer.Typer(cls=_Group, rich_markup_mode=None, **about)


class _Group(_Once, TyperGroup):
    """A group whose help has a sentence about each command; without a command it is shown."""

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        """Parse the arguments; without any, print the help and exit with the code of a mistake."""
        if not args and not ctx.resilient_parsing:
            print(self.get_help(ctx))
            ctx.exit(UsageError.exit_code)
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, each with its summary."""
        with formatter.section("Commands"):
            commands = self.commands.items()
            summaries = [(name, (each.help or "").partition("\n\n")[0]) for name, each in commands]
            formatter.write_dl(summaries)


SECONDS = {"s": 1.0, "m": 60.0, "h": 3600.0}


def seconds_of(text: str) -> float:
    """Read the time of ``--stop-after``, such as 90m, 5h or 30s.

    Raises:
        UsageError: it is not a time.
    """
    if not re.fullmatch(r"[0-9]{1,6}(\.[0-9]+)?[smh]", text) or float(text[:-1]) == 0:
        raise UsageError(f"--stop-after is a time such as 90m, 5h or 30s, not '{text}'")
    return float(text[:-1]) * SECONDS[text[-1]]


def argument(metavar: str, meaning: str) -> Any:
    """Return an argument as the help shows it."""
    return typer.Argument(metavar=metavar, help=meaning)


def option(metavar: str, meaning: str, *names: str, **more: Any) -> Any:
    """Return an option as its help shows it: what stands for the value, and what it means.

    ``names``: where they are not the parameter's.
    """
    return typer.Option(*names, metavar=metavar, help=meaning, **more)


def flag(name: str, meaning: str, **more: Any) -> Any:
    """Return an option without a value, and without an opposite as ``--no-json``."""
    return typer.Option(name, help=meaning, **more)


# Options of a group in a command's help.
episodes_option = partial(option, rich_help_panel="Episodes")
output_option = partial(option, rich_help_panel="Output")
output_flag = partial(flag, rich_help_panel="Output")
engine_option = partial(option, rich_help_panel="Engine")
isolation_option = partial(option, rich_help_panel="Isolation")
timeout_option = partial(isolation_option, "S", min=0.01, max=MAX_TIMEOUT_S)

POLICIES = (
    f"{', '.join(BUILT_IN)}, a checkpoint ({' '.join(KIND_BY_SUFFIX)}), a directory with one "
    "file per task or a LeRobot checkpoint, package.module:attribute, http://..., or "
    "hf://USER/REPO@REVISION/FILE"
)
OBJECTS = "cube, shapes (train, held-out or all), or the folder of a shape set"
ENGINE_PLACES = "; ".join(f"{name}: {where}" for name, where in ENGINES.items()) + "."

PolicyArgument = Annotated[str, argument("POLICY", POLICIES)]
RunDirectory = Annotated[Path, argument("RUN", "Directory of a finished run.")]
RunsArgument = Annotated[list[Path], argument("RUN", "Directories of finished runs.")]
TaskArgument = Annotated[str, argument("TASK", ", ".join(TASK_NAMES))]
Workers = Annotated[str, engine_option("N|auto", "Worker processes; auto: one per core.")]
EngineName = Annotated[str, engine_option("|".join(ENGINES), ENGINE_PLACES)]
Address = Annotated[
    str | None, engine_option("HOST:PORT", "ray: the cluster; without it Ray starts here.")
]
IsolationLevel = Annotated[
    str,
    isolation_option("|".join(Isolation), "See docs/explanation/isolation.md; none needs --trust."),
]
Trust = Annotated[
    bool,
    flag("--trust", "Run a policy's own Python code on this machine.", rich_help_panel="Isolation"),
]
ActTimeout = Annotated[
    float, timeout_option("Seconds a policy may take for one action; another value is unofficial.")
]
EpisodeTimeout = Annotated[
    float, timeout_option("Seconds a policy may take in an episode; another value is unofficial.")
]
StopAfter = Annotated[
    float | None,
    engine_option(
        "TIME",
        "Stop after 90m, 5h or 30s, as soon as an episode ends; what is finished is kept.",
        parser=seconds_of,
    ),
]
Resume = Annotated[bool, output_flag("--resume", "Continue the run in the directory.")]
Fresh = Annotated[bool, output_flag("--fresh", "Replace the run in the directory.")]
AsJson = Annotated[bool, flag("--json", "Print the result as JSON.")]
