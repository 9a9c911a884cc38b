import pytest

from minitouch_bench.simulation.client import PhysicsClient


@pytest.fixture
def client():
    made = PhysicsClient()
    yield made
    made.close()
