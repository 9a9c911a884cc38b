import pytest

from minitouch_bench.protocol.minitouch import MAIN_SUITE, PROTOCOL, TASK_NAMES
from minitouch_bench.verification.golden import golden_bits, recorded


def test_every_task_has_its_golden_digest():
    assert set(recorded()) == set(TASK_NAMES)


@pytest.mark.parametrize("task", TASK_NAMES)
def test_the_golden_episode_is_as_recorded(task):
    golden = recorded()[task]
    assert golden.task_digest == PROTOCOL.task_digest(task, MAIN_SUITE), (
        "a value of the protocol changed: record the golden digests again"
    )
    assert golden_bits(task) == golden.bits, "simulation changed: raise the task's revision"
