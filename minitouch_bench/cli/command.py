"""Workflow functions as commands: a function's annotated parameters are the options."""

import inspect
import re
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from copy import copy
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption
from typer.models import ArgumentInfo, OptionInfo

from minitouch_bench.cli.progress import EpisodeProgress
from minitouch_bench.errors import UsageError
from minitouch_bench.workflows import ignore
from minitouch_bench.workflows.options import COMMAND_TYPES

CALLBACKS = "callbacks"

METAVARS = {int: "N", float: "X", str: "TEXT", Path: "PATH"}
"""What stands for a value in the help, by its type on the command line."""


def as_command(
    workflow: Callable[..., Any],
    show: Callable[..., None] = ignore,
    progress: Callable[[], AbstractContextManager[object]] = EpisodeProgress,
    **defaults: object,
) -> Callable[..., None]:
    """Return a function that Typer makes a command of.

    Its parameters are the options of ``workflow`` and then those of ``show``, which prints the
    result, its first argument, and raises ``typer.Exit`` where the command fails. ``show`` can also
    ask for parameters of ``workflow`` by their name. ``progress`` gives the callbacks of
    ``workflow``, if it has some. ``defaults`` replace those of Python.
    """
    options, shown = _options(workflow, defaults), _options(show, defaults)
    shared = options.keys() & inspect.signature(show).parameters
    parameters = inspect.signature(workflow).parameters
    several = [name for name, each in parameters.items() if each.kind is each.VAR_POSITIONAL]

    def run(**given: Any) -> None:
        for_show = {name: given.pop(name) for name in shown}
        for_show |= {name: given[name] for name in shared}
        values = [value for name in several for value in given.pop(name)]
        with ExitStack() as stack:
            if CALLBACKS in parameters:
                given[CALLBACKS] = stack.enter_context(progress())
            result = workflow(*values, **given)
        show(result, **for_show)

    every = [*options.values(), *shown.values()]
    run.__name__ = workflow.__name__
    run.__doc__ = (inspect.getdoc(workflow) or "").partition("\n\n")[0]
    run.__signature__ = inspect.Signature(every)  # type: ignore[attr-defined]
    run.__annotations__ = {option.name: option.annotation for option in every}
    return run


def _options(
    function: Callable[..., Any], defaults: dict[str, object]
) -> dict[str, inspect.Parameter]:
    """Return the parameters that are given on the command line, as Typer reads them."""
    options, helps = {}, _parameter_help(function)
    for name, parameter in inspect.signature(function).parameters.items():
        option = _option_of(parameter)
        if option is None:
            continue
        option = copy(option)
        option.help = option.help or helps.get(name, "")
        kind = get_args(parameter.annotation)[0]
        kind = list[Path] if parameter.kind is parameter.VAR_POSITIONAL else kind
        default = defaults.get(name, parameter.default)
        if default is False and option.default is ... and not option.param_decls:
            # A switch, with no --no-NAME beside it.
            option.param_decls = (f"--{name.replace('_', '-')}",)
        options[name] = inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            annotation=Annotated[COMMAND_TYPES.get(kind, kind), option],
            default=default,
        )
    return options


def _option_of(parameter: inspect.Parameter) -> ArgumentInfo | OptionInfo | None:
    """Return how a parameter is given on the command line, None where it is not."""
    if get_origin(parameter.annotation) is not Annotated:
        return None
    details = get_args(parameter.annotation)[1:]
    return next((each for each in details if isinstance(each, ArgumentInfo | OptionInfo)), None)


def _parameter_help(function: Callable[..., Any]) -> dict[str, str]:
    """Return what the section ``Args`` of a docstring says of each parameter."""
    section = (inspect.getdoc(function) or "").partition("\nArgs:\n")[2].partition("\n\n")[0]
    entries = re.findall(r"^ {4}(\w+): (.*(?:\n {5,}.*)*)", section, re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}


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

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        for parameter in self.params:
            if isinstance(parameter, TyperOption):
                kind = parameter.type_descriptor.annotation
                parameter.metavar = parameter.metavar or METAVARS.get(kind)
            elif isinstance(parameter, TyperArgument):
                parameter.metavar = parameter.metavar or str(parameter.name).upper()

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
    return typer.Typer(cls=_Group, no_args_is_help=True, rich_markup_mode=None, **about)


class _Group(_Once, TyperGroup):
    """A group whose help has a whole sentence about each command."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, each with its summary."""
        with formatter.section("Commands"):
            commands = self.commands.items()
            summaries = [(name, (each.help or "").partition("\n\n")[0]) for name, each in commands]
            formatter.write_dl(summaries)
