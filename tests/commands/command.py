"""The installed command, run as a user runs it."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

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


def start(*arguments: object, directory: Path) -> subprocess.Popen[str]:
    """Start the command, leading a process group of its own."""
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        cwd=directory,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finish(process: subprocess.Popen[str]) -> Finished:
    out, err = process.communicate(timeout=120)
    return Finished(process.returncode, out, err)


def run(*arguments: object, directory: Path) -> Finished:
    return finish(start(*arguments, directory=directory))
