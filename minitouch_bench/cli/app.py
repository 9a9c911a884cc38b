"""The application ``minitouch-bench`` and how its errors reach a user."""

import sys

import typer
from rich.console import Console

from minitouch_bench.cli.evaluate import evaluate
from minitouch_bench.cli.report import report
from minitouch_bench.cli.tasks import tasks
from minitouch_bench.errors import MiniTouchError

app = typer.Typer(
    name="minitouch-bench",
    help="Evaluate touch-driven manipulation policies on the MiniTouch benchmark.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command()(evaluate)
app.command()(report)
app.command()(tasks)


def main() -> None:
    """Run the command line; a mistake of the user's ends in a line or two, no traceback."""
    try:
        app()
    except MiniTouchError as error:
        console = Console(stderr=True, soft_wrap=True)
        console.print(f"minitouch-bench: {error}", style="red", markup=False, highlight=False)
        sys.exit(error.exit_code)
