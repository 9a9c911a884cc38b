"""A system without what only Linux has, such as macOS; simulated, because none is at hand."""

from functools import partial

import pytest

from minitouch_bench.runs.run import read_run
from tests.process_tree import run_python
from tests.test_layers import MODULES

WITHOUT = """
import ctypes, os, platform, socket
platform.system = lambda: "Darwin"
del os.pidfd_open, os.sched_getaffinity, socket.MSG_CMSG_CLOEXEC
def killpg(group, number):
    raise PermissionError("all of it have exited")
os.killpg = killpg
class Library(ctypes.CDLL):
    def __getattr__(self, name):
        if name in ("prctl", "syscall"):
            raise AttributeError(name)
        return super().__getattr__(name)
ctypes.CDLL = Library
"""


@pytest.fixture
def elsewhere(tmp_path):
    """A function that runs the command on such a system."""
    folder = tmp_path / "system"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(WITHOUT)
    (tmp_path / "work").mkdir()

    return partial(
        run_python, "-m", "minitouch_bench", cwd=tmp_path / "work", PYTHONPATH=str(folder)
    )


def test_a_run_in_a_process_has_the_same_digest_and_is_unofficial(elsewhere, tmp_path):
    episodes = ("evaluate", "random", "--tasks", "pushing", "--episodes", "2", "--workers", "2")
    elsewhere(*episodes, "--isolation", "process", "--output", "run")
    run_python("-m", "minitouch_bench", *episodes, "--output", "here", cwd=tmp_path)
    found, expected = (read_run(tmp_path / place) for place in ("work/run", "here"))
    assert found.digest == expected.digest
    assert not found.header.official
    assert "isolation: process" in found.header.unofficial_because


def test_everything_is_imported():
    names = (path.removesuffix(".py").replace("/", ".") for path in MODULES)
    imports = "\n".join(f"import minitouch_bench.{name}" for name in names if name[0] != "_")
    # torch here is a build for Linux, and loads its libraries by the system's name.
    run_python("-c", f"import torch\n{WITHOUT}\n{imports}")
