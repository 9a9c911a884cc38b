import pytest

from minitouch_bench.agents.training_directory import run_training
from tests.agents.trainings import CONFIG


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory):
    """A finished training, which nobody may change."""
    directory = tmp_path_factory.mktemp("undisturbed")
    assert run_training(CONFIG, directory, device="cpu")
    return directory
