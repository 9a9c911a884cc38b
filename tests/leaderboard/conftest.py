import shutil
from functools import lru_cache
from pathlib import Path

import pytest

from minitouch_bench.metrics.summary import summarize
from tests.leaderboard.synthetic import make_submission


@pytest.fixture(scope="package", autouse=True)
def summarize_once():
    """Estimate the same episodes once in all: most of these tests spoil something else."""
    with pytest.MonkeyPatch.context() as patch:
        remembered = lru_cache(maxsize=16)(summarize)
        for module in ("runs.run", "verification.static_check"):
            patch.setattr(f"minitouch_bench.{module}.summarize", remembered)
        yield


@pytest.fixture(scope="session")
def sound(tmp_path_factory) -> Path:
    """A submission that passes, which nobody may change."""
    return make_submission(tmp_path_factory.mktemp("sound"), exploration=True)


@pytest.fixture
def submission(sound, tmp_path) -> Path:
    """A copy of it to spoil."""
    return Path(shutil.copytree(sound, tmp_path / "submissions" / "hac"))
