import pytest

from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.task import TASK_CLASSES


@pytest.fixture(scope="session")
def environments() -> dict[str, MiniTouchEnv]:
    """One environment a task, shared: that episodes do not disturb each other is a promise."""
    return {task: MiniTouchEnv(task) for task in TASK_CLASSES}


@pytest.fixture(params=list(TASK_CLASSES))
def environment(request, environments) -> MiniTouchEnv:
    """Each task in turn."""
    return environments[request.param]
