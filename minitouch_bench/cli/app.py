"""The application ``minitouch-bench`` and how its errors reach a user."""

import sys

import typer

from minitouch_bench.cli.compare import compare
from minitouch_bench.cli.consoles import notes
from minitouch_bench.cli.doctor import doctor
from minitouch_bench.cli.evaluate import evaluate
from minitouch_bench.cli.leaderboard import app as leaderboard
from minitouch_bench.cli.regress import regress
from minitouch_bench.cli.replay import replay
from minitouch_bench.cli.report import report
from minitouch_bench.cli.shapes import app as shapes
from minitouch_bench.cli.submit import submit
from minitouch_bench.cli.tasks import tasks
from minitouch_bench.cli.train import train
from minitouch_bench.cli.verify import verify
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
app.command()(compare)
app.command()(regress)
app.command()(tasks)
app.command()(verify)
app.command()(replay)
app.command()(train)
app.command()(doctor)
app.command()(submit)
app.add_typer(leaderboard, name="leaderboard")
app.add_typer(shapes, name="shapes")


INTERRUPTED = 130
"""What typer returns after a Ctrl-C that no command has told the user about."""


def main() -> None:
    """Run the command line; a mistake of the user's ends in a line or two, no traceback."""
    try:
        # So that usage errors come here too; the code of a typer.Exit is then returned.
        code = app(standalone_mode=False)
    except MiniTouchError as error:
        _complain(str(error))
        sys.exit(error.exit_code)
    except typer.TyperException as error:
        # Where no arguments are given the message is empty: the help has been printed.
        if error.format_message().strip():
            _complain(f"{error.format_message()}\nSee minitouch-bench --help")
        sys.exit(error.exit_code)
    if code == INTERRUPTED:
        _complain("interrupted")
    sys.exit(code)


def _complain(text: str) -> None:
    notes.print(f"minitouch-bench: {text}", style="red", markup=False)
