"""The application ``minitouch-bench`` and how its errors reach a user."""

import sys
from collections.abc import Callable
from importlib.metadata import version
from typing import Annotated

import typer

from minitouch_bench.cli.command import as_command
from minitouch_bench.cli.compare import compare
from minitouch_bench.cli.console import notes
from minitouch_bench.cli.doctor import doctor
from minitouch_bench.cli.evaluate import show_evaluation
from minitouch_bench.cli.leaderboard import app as leaderboard
from minitouch_bench.cli.record import show_dataset
from minitouch_bench.cli.regress import regress
from minitouch_bench.cli.replay import show_replay
from minitouch_bench.cli.report import report
from minitouch_bench.cli.shapes import app as shapes
from minitouch_bench.cli.study import study
from minitouch_bench.cli.submit import submit
from minitouch_bench.cli.tasks import tasks
from minitouch_bench.cli.train import show_directory, training_progress
from minitouch_bench.cli.verify import show_verification
from minitouch_bench.errors import MiniTouchError
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.workflows.evaluate import evaluate
from minitouch_bench.workflows.record import record
from minitouch_bench.workflows.replay import replay
from minitouch_bench.workflows.train import train
from minitouch_bench.workflows.verify import verify

INTERRUPTED = 130
"""What typer returns after a Ctrl-C that no command has told the user about."""

COMMANDS: dict[Callable[..., None], str] = {
    as_command(evaluate, show_evaluation): "minitouch-bench evaluate my_policy.onnx --suite smoke",
    report: "minitouch-bench report reports/a reports/b --output reports/both",
    compare: "minitouch-bench compare reports/a reports/b",
    regress: "minitouch-bench regress new.onnx --baseline reports/old",
    as_command(verify, show_verification): "minitouch-bench verify reports/a --rerun 20",
    as_command(replay, show_replay): "minitouch-bench replay reports/a pushing/3",
    as_command(
        train, show_directory, training_progress
    ): "minitouch-bench train opening --method hac --seed 1",
    study: "minitouch-bench study my-study.toml",
    as_command(
        record, show_dataset
    ): "minitouch-bench record scripted pushing --output data/pushing",
    submit: "minitouch-bench submit my_policy.onnx --name my-policy",
    tasks: "minitouch-bench tasks --json",
    doctor: "minitouch-bench doctor",
}
"""Every command with an example of its use, in the order of the help."""

PROGRAM = "minitouch-bench"

app = typer.Typer(name=PROGRAM, no_args_is_help=True, pretty_exceptions_enable=False)
for command, example in COMMANDS.items():
    app.command(epilog=f"Example: {example}")(command)
app.add_typer(leaderboard, name="leaderboard")
app.add_typer(shapes, name="shapes")


def _print_version(asked: bool) -> None:
    if asked:
        print(f"minitouch-bench {version('minitouch-bench')}")
        raise typer.Exit


@app.callback()
def minitouch_bench(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print it.")
    ] = False,
) -> None:
    """Evaluate touch-driven manipulation policies on the MiniTouch benchmark."""


def main() -> None:
    """Run the command line; a user's mistake ends in a line or two, without a traceback."""
    try:
        # So that usage errors come here too; the code of a typer.Exit is then returned.
        code = app(prog_name=PROGRAM, standalone_mode=False)
    except MiniTouchError as error:
        _complain(str(error))
        sys.exit(error.exit_code)
    except typer.TyperException as error:
        # Where no arguments are given the message is empty: the help has been printed.
        if error.format_message().strip():
            context = getattr(error, "ctx", None)
            command = context.command_path if context else PROGRAM
            _complain(f"{error.format_message()}\nSee {command} --help")
        sys.exit(error.exit_code)
    if code == INTERRUPTED:
        _complain("interrupted")
    sys.exit(code)


def _complain(text: str) -> None:
    lines = "\n".join(map(printable, text.splitlines()))  # it may quote a stranger's name
    notes.print(f"minitouch-bench: {lines}", style="red", markup=False)
