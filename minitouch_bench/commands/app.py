"""The application ``minitouch-bench`` and how its errors reach a user."""

import os
import sys
from collections.abc import Callable
from typing import Annotated

import typer

from minitouch_bench.commands.compare import compare
from minitouch_bench.commands.evaluate import evaluate
from minitouch_bench.commands.facts import doctor, tasks
from minitouch_bench.commands.leaderboard import app as leaderboard
from minitouch_bench.commands.options import Command, make_group
from minitouch_bench.commands.record import record
from minitouch_bench.commands.regress import regress
from minitouch_bench.commands.replay import replay
from minitouch_bench.commands.report import report
from minitouch_bench.commands.shapes import app as shapes
from minitouch_bench.commands.submit import submit
from minitouch_bench.commands.train import train
from minitouch_bench.commands.verify import verify
from minitouch_bench.console import note
from minitouch_bench.errors import (
    InterruptedRunError,
    MiniTouchError,
    RunDirectoryError,
    UsageError,
)

COMMANDS: dict[Callable[..., None], str] = {
    evaluate: "evaluate my_policy.onnx --suite smoke",
    report: "report reports/a reports/b --output reports/both",
    compare: "compare reports/a reports/b",
    regress: "regress new.onnx --baseline reports/old",
    verify: "verify reports/a --rerun 20",
    replay: "replay reports/a pushing/3",
    train: "train opening --method hac --seed 1",
    record: "record scripted pushing --output data/pushing",
    submit: "submit my_policy.pt2 --name my-policy --learner PPO --training-steps 20000",
    tasks: "tasks --json",
    doctor: "doctor",
}
"""Every command with an example of its use, in the order of the help."""

PROGRAM = "minitouch-bench"

FIRST = "First: minitouch-bench evaluate random --suite smoke. Each command has --help."

app = make_group(name=PROGRAM, pretty_exceptions_enable=False, epilog=FIRST)
for command, example in COMMANDS.items():
    app.command(cls=Command, epilog=f"Example: {PROGRAM} {example}")(command)
app.add_typer(leaderboard, name="leaderboard")
app.add_typer(shapes, name="shapes")


def _print_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        print(f"{PROGRAM} {version(PROGRAM)}")
        raise typer.Exit


@app.callback()
def minitouch_bench(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Evaluate touch-driven manipulation policies on the MiniTouch benchmark."""


def main() -> None:
    """Run the command line; a user's mistake ends in a line or two, without a traceback."""
    try:
        _check_encoding()
        # So that usage errors come here too; the code of a typer.Exit is then returned.
        arguments = [*map(_with_home, sys.argv[1:])]
        code = app(arguments, prog_name=PROGRAM, standalone_mode=False)
    except MiniTouchError as error:
        _complain(str(error))
        sys.exit(error.exit_code)
    except typer.TyperException as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context else PROGRAM
        _complain(f"{error.format_message()}\nSee {command} --help")
        sys.exit(error.exit_code)
    except OSError as error:  # such as a name that is too long, or a directory without permission
        if error.filename is None:
            raise
        _complain(f"{error.filename} cannot be used: {error.strerror}")
        sys.exit(RunDirectoryError.exit_code)
    # What Typer returns after a Ctrl-C that no command has told the user about.
    if code == InterruptedRunError.exit_code:
        _complain("interrupted")
    sys.exit(code)


def _check_encoding() -> None:
    """See that each argument and the working directory can be written into the files of a run.

    Raises:
        UsageError: one has bytes that are not UTF-8, as the name of a file can have, or the
            directory was removed.
    """
    try:
        directory = os.getcwd()
    except FileNotFoundError:
        raise UsageError("the working directory was removed: change to another one") from None
    for name in (*sys.argv[1:], directory):
        try:
            name.encode()
        except UnicodeEncodeError as error:
            raise UsageError(f"{name!a} is not UTF-8: rename the file or directory") from error


def _with_home(argument: str) -> str:
    """Replace the ``~`` of an argument, in ``--option=~/path`` as well, where no shell does it."""
    is_option = argument.startswith("--")
    option, equals, path = argument.partition("=") if is_option else ("", "", argument)
    return f"{option}{equals}{os.path.expanduser(path)}"


def _complain(text: str) -> None:
    note(f"{PROGRAM}: {text}", style="red")
