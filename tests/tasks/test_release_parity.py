"""Our arm against the released package's, from the same starts with the same actions.

``tests/data/release_traces.npz`` holds what the release did with 60 random actions per task:
``columns`` names the columns of ``TASK.rows``; ``actions`` float64 (60, 5).
"""

import math
from pathlib import Path

import numpy as np
import pytest

from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.task import TASK_CLASSES

TRACES = np.load(Path(__file__).parents[1] / "data" / "release_traces.npz")
COLUMNS = list(TRACES["columns"])
OBJECTS = {"playing": (0.62, 0.03), "pushing": (0.40, 0.02), "pick-up": (0.62, 0.02)}
CABINET = (0.70, 0.0)
DRIFT_M = {"pick-up": 1.4e-3}
"""The release stops up to 0.4 mm short of a target near full reach, and the shortfall adds up
over the steps: in Pick-up, which touches nothing for 60 steps, to 1.3 mm."""


@pytest.fixture(params=list(TASK_CLASSES))
def environment(request, monkeypatch):
    task = request.param
    made = MiniTouchEnv(task, **({} if task == "opening" else {"objects": "cube"}))

    def draw(rng, model):
        if task == "opening":
            made.task.position = CABINET
            return
        made.task.model, made.task.position, made.task.yaw = model, OBJECTS[task], 0.0
        if task == "pushing":
            made.task.target = (0.50, 0.07)
            made.task._start = tuple(TRACES["pushing.rows"][0][:2])

    monkeypatch.setattr(made.task, "draw", draw)
    return made


def test_the_arm_follows_the_release_until_it_touches(environment):
    task = environment.task.spec.name
    environment.reset(seed=0)
    size, followed = environment.action_space.shape[0], 0
    for action, row in zip(TRACES["actions"], TRACES[f"{task}.rows"], strict=True):
        step = dict(zip(COLUMNS, row, strict=True))
        observation, *_, info = environment.step(action[:size].astype(np.float32))
        touched = environment.client.contacts(environment.arm.body, environment.task.target_body)
        if info["contact_ticks"] or step["finger_object_contacts"] or touched:
            break
        theirs = [step[f"end_{axis}"] for axis in "xyz"]
        assert math.dist(environment.arm.position, theirs) < DRIFT_M.get(task, 1.1e-3)
        forces = [step[f"force_{side}{axis}"] for side in "lr" for axis in "xyz"]
        assert observation["touch"][5:] == pytest.approx(forces, abs=0.1)  # the fingers' weight
        assert info["ticks"] <= step["ticks"]
        followed += 1
    assert followed >= 3
