import socket
import threading
import time
from contextlib import closing

import numpy as np
import pytest

from minitouch_bench.episode import Outcome
from minitouch_bench.errors import (
    InfrastructureError,
    InvalidActionError,
    PolicyLoadError,
    PolicyTimeoutError,
)
from minitouch_bench.evaluation import rollout
from minitouch_bench.evaluation.rollout import EpisodeRunner, run_episode
from minitouch_bench.policies.scripted import ScriptedPolicy
from minitouch_bench.policies.server import PolicyServer
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.task import TASK_CLASSES
from tests.evaluation import runs
from tests.evaluation.misbehaved import Still

SPECS = {spec.task: spec for spec in make_plan("smoke").specs()}


@pytest.fixture(scope="module", params=list(TASK_CLASSES))
def environment(request):
    made = MiniTouchEnv(request.param, max_episode_steps=30)
    yield made
    made.close()


class Failing(Still):
    """Fails after so many actions; after none, when the episode begins."""

    def __init__(self, error, actions):
        self.error, self.actions = error, actions

    def reset(self, seed, task):
        if not self.actions:
            raise self.error

    def act(self, observation):
        if self.steps == self.actions:
            raise self.error
        return super().act(observation)


def test_a_trace_has_one_row_a_step(environment):
    spec = SPECS[environment.task.spec.name]
    record = run_episode(environment, ScriptedPolicy(lambda _: environment), spec)
    trace, steps = record.trace, len(record.trace.actions)
    size, states = environment.action_space.shape[0], 1 if spec.task == "opening" else 3
    shapes = {
        "actions": (np.float32, (steps, size)),
        "clipped": (np.bool_, (steps,)),
        "rewards": (np.float32, (steps,)),
        "ticks": (np.int16, (steps,)),
        "contact_ticks": (np.int16, (steps,)),
        "onsets": (np.int16, (steps,)),
        "touch": (np.float32, (steps + 1, 11)),
        "object_state": (np.float64, (steps + 1, states)),
    }
    for name, (dtype, shape) in shapes.items():
        array = getattr(trace, name)
        assert (array.dtype, array.shape) == (dtype, shape)
    assert 0 < steps <= 30
    assert record.outcome in (Outcome.SUCCESS, Outcome.STEP_LIMIT)
    assert record.trace.rewards.sum() == (25.0 if record.outcome is Outcome.SUCCESS else 0.0)
    assert record.fault == ""
    again = run_episode(environment, ScriptedPolicy(lambda _: environment), spec)
    assert again.trace.digest() == trace.digest()


@pytest.mark.parametrize("environment", ["pushing"], indirect=True)
@pytest.mark.parametrize(
    ("error", "actions"),
    [(InvalidActionError("NaN"), 3), (PolicyTimeoutError("late"), 3), (PolicyLoadError("gone"), 0)],
)
def test_a_fault_ends_the_episode_and_keeps_what_was(environment, error, actions):
    record = run_episode(environment, Failing(error, actions), SPECS["pushing"])
    assert record.outcome is Outcome.POLICY_FAULT
    assert record.fault == str(error)
    assert record.trace.actions.shape == (actions, 4)
    assert record.trace.touch.shape == (actions + 1, 11)


def test_an_episode_waits_for_its_server_and_the_machine_is_at_fault_if_it_stays_away(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = taken.getsockname()
    wanted = runs.request(f"http://127.0.0.1:{address[1]}", ("opening",), 1)
    (spec,) = wanted.plan.specs()
    tries = []

    def serve_after_two(pause_s):
        tries.append(pause_s)
        if len(tries) == 2:
            server = PolicyServer(Still, address)
            threading.Thread(target=server.serve_forever, daemon=True).start()

    with closing(EpisodeRunner(wanted)) as runner, monkeypatch.context() as patch:
        patch.setattr(rollout, "UNREACHABLE_S", 0.0)
        with pytest.raises(InfrastructureError, match="cannot be reached"):
            runner.run(spec)
        patch.setattr(rollout, "UNREACHABLE_S", 60.0)
        patch.setattr(time, "sleep", serve_after_two)
        played = runner.run(spec)
    assert (played.outcome, played.fault, len(tries)) == (Outcome.STEP_LIMIT, "", 2)
