import shutil
from pathlib import Path

import pytest

from minitouch_bench.leaderboard import fresh
from minitouch_bench.metrics import statistics
from tests.leaderboard.browser import browser, started_browser  # noqa: F401
from tests.leaderboard.synthetic import make_submission


@pytest.fixture(scope="package", autouse=True)
def few_resamples():
    """Estimate from few resamples: these tests need the same intervals twice, not good ones."""
    whole = statistics.bootstrap
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(statistics, "bootstrap", lambda samples, rng: whole(samples, rng, 100))
        patch.setattr(fresh, "ORDERS", 2000)
        yield


@pytest.fixture(scope="package")
def sound(tmp_path_factory) -> Path:
    """A submission that passes, which nobody may change."""
    root = tmp_path_factory.mktemp("sound")
    return make_submission(root, seeds=(0, 1), exploration=True)


@pytest.fixture
def submission(sound, tmp_path) -> Path:
    """A copy of it to spoil."""
    return Path(shutil.copytree(sound, tmp_path / "submissions" / "hac"))
