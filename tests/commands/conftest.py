import shutil
from pathlib import Path

import pytest

from tests.commands.command import Finished, run
from tests.leaderboard.browser import browser, started_browser  # noqa: F401

ONE = ("--tasks", "pushing", "--episodes", "1", "--workers", "1")
SCRIPTED = ("evaluate", "scripted", "--tasks", "pushing,opening", "--episodes", "2")


@pytest.fixture
def copy(scripted, tmp_path):
    """A copy of the scripted policy's run."""
    return shutil.copytree(scripted[1], tmp_path / "copy")


@pytest.fixture(scope="session")
def scripted(tmp_path_factory) -> tuple[Finished, Path]:
    """A finished run of four episodes, which nobody may change."""
    directory = tmp_path_factory.mktemp("cli")
    done = run(*SCRIPTED, "--workers", 1, "--output", directory / "run", directory=directory)
    return done, directory / "run"
