import pytest

from minitouch_bench.runs.run import Run
from tests.leaderboard.browser import browser, started_browser  # noqa: F401
from tests.reporting.synthetic import SHAPE_TASKS, make_run, save, with_shapes


@pytest.fixture(scope="session")
def hac() -> Run:
    return save(make_run("hac-seed1", episodes=20, faults=2), "hac-seed1")


@pytest.fixture(scope="session")
def scripted() -> Run:
    run = make_run(
        "scripted",
        tasks=("playing", "pushing"),
        episodes=5,
        skill=1.0,
        exploration=False,
        notes=("reads the simulator's state",),
        official=False,
    )
    return save(run, "scripted-smoke")


@pytest.fixture(scope="session")
def novel() -> Run:
    run = make_run("hac-seed1", tasks=SHAPE_TASKS, episodes=40, skill=0.7, exploration=False)
    return save(with_shapes(run), "novel")


HOSTILE = "=cmd|' /C calc'!A0 <script>alert(1)</script> $x$ `a` [b](c) \x1b[31m\u202e&"


@pytest.fixture(scope="session")
def hostile() -> Run:
    run = make_run(HOSTILE, tasks=("pushing",), episodes=4, faults=1, notes=(HOSTILE,))
    return save(run, HOSTILE)
