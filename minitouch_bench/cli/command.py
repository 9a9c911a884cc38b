"""How every command parses its options and shows its help, beyond what Typer does."""

from collections import Counter
from typing import Any

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption

from minitouch_bench.errors import UsageError


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
    return typer.Typer(cls=_Group, no_args_is_help=True, rich_markup_mode=None, **about)


class _Group(_Once, TyperGroup):
    """A group whose help has a whole sentence about each command."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, each with its summary."""
        with formatter.section("Commands"):
            commands = self.commands.items()
            summaries = [(name, (each.help or "").partition("\n\n")[0]) for name, each in commands]
            formatter.write_dl(summaries)
