import pytest
import torch

from minitouch_bench.agents.training_directory import run_training
from tests.agents.trainings import CONFIG


@pytest.fixture(autouse=True)
def as_many_threads_as_before():
    """Take back how many threads a test lets torch have."""
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory):
    """A finished training, which nobody may change."""
    directory = tmp_path_factory.mktemp("undisturbed")
    assert run_training(CONFIG, directory, device="cpu")
    return directory
