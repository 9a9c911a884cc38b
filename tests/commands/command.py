"""The command as a user runs it: in this process, or installed in one of its own."""

import contextlib
import io
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from minitouch_bench.commands.app import main
from minitouch_bench.files import JOURNAL_FILE
from tests.process_tree import wait_until

COMMAND = [sys.executable, "-W", "error::SyntaxWarning", "-m", "minitouch_bench"]


@dataclass(frozen=True)
class Finished:
    code: int
    out: str
    err: str

    def refused(self, code: int, *words: str) -> None:
        """Check that a mistake ended in one or two lines on stderr that hold these words."""
        assert self.code == code, self.err
        assert self.out == ""
        assert "Traceback" not in self.err
        assert 1 <= len(self.err.strip().splitlines()) <= 2, self.err
        assert self.err.startswith("minitouch-bench: ")
        for word in words:
            assert word in self.err


def run(*arguments: object, directory: Path) -> Finished:
    """Run the command in this process: its modules are loaded once for all tests."""
    out, err = io.StringIO(), io.StringIO()
    code: object = 0
    argv = ["minitouch-bench", *map(str, arguments)]
    with (
        contextlib.chdir(directory),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        mock.patch.object(sys, "argv", argv),
    ):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
    assert isinstance(code, int)
    return Finished(code, out.getvalue(), err.getvalue())


def succeed(*arguments: object, directory: Path) -> Finished:
    """Run the command in this process, and check that it ends with 0."""
    done = run(*arguments, directory=directory)
    assert done.code == 0, done.out + done.err
    return done


def start(*arguments: object, directory: Path) -> subprocess.Popen[str]:
    """Start the installed command, leading a process group of its own."""
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        cwd=directory,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finish(process: subprocess.Popen[str]) -> Finished:
    out, err = process.communicate(timeout=250)
    return Finished(process.returncode, out, err)


def wait_for_records(run: Path, count: int, process: subprocess.Popen[str]) -> None:
    """Wait until so many episodes of a run under way are kept; 0: until it has begun."""
    journal = run / JOURNAL_FILE

    def is_kept() -> bool:
        assert process.poll() is None
        return journal.exists() and journal.read_bytes().count(b"\n") >= count

    wait_until(is_kept, 250)


def same_results(one: Path, other: Path) -> None:
    """Compare two runs; only what they say of the machine and the time may differ."""
    for name in ("actions.npz", "episodes.csv"):
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    documents = [json.loads((directory / "run.json").read_text()) for directory in (one, other)]
    for document in documents:
        del document["environment"]
    assert documents[0] == documents[1]


def run_installed(*arguments: object, directory: Path) -> Finished:
    return finish(start(*arguments, directory=directory))
