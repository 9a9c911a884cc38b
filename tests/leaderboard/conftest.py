import shutil
from pathlib import Path

import pytest

from tests.leaderboard.synthetic import make_submission


@pytest.fixture(scope="session")
def sound(tmp_path_factory) -> Path:
    """A submission that passes, which nobody may change."""
    return make_submission(tmp_path_factory.mktemp("sound"), exploration=True)


@pytest.fixture
def submission(sound, tmp_path) -> Path:
    """A copy of it to spoil."""
    return Path(shutil.copytree(sound, tmp_path / "submissions" / "hac"))
