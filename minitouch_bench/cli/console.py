"""Where the command line prints: data on stdout, progress and notes on stderr."""

from collections.abc import Iterable

from rich.console import Console

from minitouch_bench.errors import printable

PIPED_WIDTH = 120
"""Columns of a table that goes into a file or another program."""

notes = Console(stderr=True, soft_wrap=True, highlight=False)


def note(text: str, style: str = "") -> None:
    """Print a line on stderr."""
    notes.print(text, markup=False, style=style)


def data_console() -> Console:
    """Return the console of stdout, as wide as the screen, or as a page where there is none."""
    console = Console()
    return console if console.is_terminal else Console(width=PIPED_WIDTH)


def print_problems(name: str, problems: Iterable[object]) -> None:
    """Print a line for each problem of a submission."""
    for problem in problems:
        print(f"{printable(name)}: {problem}")
