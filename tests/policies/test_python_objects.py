import contextlib
import importlib
import os
import sys

import numpy as np
import pytest
import torch

from minitouch_bench.errors import (
    PolicyFaultError,
    PolicyLoadError,
    PolicyRaisedError,
    ServerUnreachableError,
)
from minitouch_bench.policies.policy import Isolation, IsolationOptions
from minitouch_bench.policies.policy_process import isolate
from minitouch_bench.policies.python_objects import keep_in_memory, load_object, make_policy
from minitouch_bench.policies.sources import parse_source
from tests.process_tree import run_python

BUGS = """
import json
import torch

def read(text):
    return json.loads(text)

class Bugs:
    def reset(self, seed, task):
        self.seed = seed

    def act(self, observation):
        if self.seed == 0:
            return observation["object_state"]
        if self.seed == 1:
            return read("")
        actions = torch.zeros(1, 4, requires_grad=True)
        return actions if self.seed == 2 else (actions.detach().numpy(), None)
"""
FAULTS = [
    "the policy said: KeyError: 'object_state' (bugs.py:14 in act)",
    "the policy said: JSONDecodeError: Expecting value: line 1 column 1 (char 0) "
    "(bugs.py:6 in read)",
    "the action is a tensor that requires grad: use torch.no_grad() or .detach()",
    "the action is in a tuple: return the action alone",
]


def test_a_fault_names_the_line_of_the_policy_at_every_level(tmp_path, monkeypatch, observation):
    (tmp_path / "bugs.py").write_text(BUGS)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.syspath_prepend(tmp_path)
    factory = parse_source("bugs:Bugs")
    in_memory = keep_in_memory(importlib.import_module("bugs").Bugs())
    monkeypatch.delitem(sys.modules, "bugs")
    cases = [(factory, Isolation.SANDBOX), (factory, Isolation.NONE), (in_memory, Isolation.NONE)]
    for source, level in cases:
        said = []
        with contextlib.closing(isolate(source, IsolationOptions(level, trust=True))) as policy:
            for seed in range(len(FAULTS)):
                policy.reset(seed, "pushing")
                with pytest.raises(PolicyFaultError) as caught:
                    policy.act(observation)
                said.append(str(caught.value))
        assert said == FAULTS


class Unspeakable(BaseException):
    __str__ = sys.exit


ENDS = [SystemExit, GeneratorExit, StopIteration, Unspeakable, ServerUnreachableError]


class Ending:
    """Raises at one place."""

    def __init__(self, place, error):
        self.place, self.error = place, error
        self.end("made")

    def end(self, place):
        if place == self.place:
            raise self.error

    def __getstate__(self):
        self.end("pickled")
        return vars(self)

    def __setstate__(self, state):
        vars(self).update(state)
        self.end("loaded")

    def reset(self, seed, task):
        self.end("reset")

    def act(self, observation):
        self.end("act")
        return self if self.place == "array" else [0.0] * 4

    def __array__(self, *_, **__):
        self.end("array")

    def close(self):
        self.end("close")


@pytest.mark.parametrize("error", ENDS)
def test_what_would_end_the_program_is_a_fault_beside_the_simulator(error, observation):
    def play(place):
        with contextlib.closing(isolate(keep_in_memory(Ending(place, error)))) as policy:
            policy.reset(0, "pushing")
            return policy.act(observation).tolist()

    for place in ("pickled", "loaded"):
        with pytest.raises(PolicyLoadError):
            play(place)
    for place in ("reset", "act", "array"):
        with pytest.raises(PolicyFaultError):
            play(place)
    assert play("close") == [0.0] * 4


@pytest.mark.parametrize("place", ["pickled", "loaded", "reset", "act"])
def test_ctrl_c_is_not_a_fault_of_the_policy(place, observation):
    def play():
        policy = isolate(keep_in_memory(Ending(place, KeyboardInterrupt)))
        policy.reset(0, "pushing")
        policy.act(observation)

    with pytest.raises(KeyboardInterrupt):
        play()


class Overwriting:
    def act(self, observation):
        seen = observation["touch"][:4].copy()
        observation["touch"].fill(9.0)
        observation["image"].fill(9)
        return seen


def test_a_policy_that_overwrites_its_observation_overwrites_its_copy(observation):
    given = {name: value.copy() for name, value in observation.items()}
    with contextlib.closing(isolate(keep_in_memory(Overwriting()))) as policy:
        policy.reset(0, "pushing")
        assert np.array_equal(policy.act(given), observation["touch"][:4])
    assert all(np.array_equal(given[name], observation[name]) for name in observation)


class Still(torch.nn.Module):
    """Its ``predict`` is its own, and none of Stable-Baselines3."""

    def forward(self, image, touch):
        return 0.0 * touch[:, :4]

    def predict(self, image):
        raise NotImplementedError


class Narrow(torch.nn.Module):
    def forward(self, image, touch):
        return touch @ torch.zeros(12, 4)


@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
@pytest.mark.parametrize("factory", [Still, lambda: torch.jit.script(Still())])
def test_a_factory_can_make_a_torch_module(observation, factory):
    policy = make_policy(factory, deterministic=True)
    policy.reset(0, "pushing")
    assert policy.act(observation).tolist() == [[0.0] * 4]


def test_a_fault_of_a_torch_module_has_its_line(observation):
    place = r"multiplied .* \(test_python_objects\.py:\d+ in forward\)$"
    with pytest.raises(PolicyRaisedError, match=place):
        load_object(keep_in_memory(Narrow())).act(observation)


DIGESTS = """
import enum
import pathlib
import torch
from minitouch_bench.policies.python_objects import keep_in_memory
Side = enum.Enum("Side", ["LEFT", "RIGHT", "BACK"])
class Net(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.layer = torch.nn.Linear(11, 4)
        for name in ("alpha", "beta", "gamma", "delta"):
            self.register_buffer(name, torch.ones(2, dtype=torch.bfloat16), persistent=False)
class Planner:
    def __init__(self, net):
        self.net, self.seen = net, {("left", 1), "right", None, 2.5, b"x"}
        self.sides, self.types = {*Side}, {torch.float32, torch.int8, torch.bool}
        self.paths = {frozenset(map(pathlib.Path, "abcd")), frozenset(map(pathlib.Path, "efgh"))}
        self.storage = torch.arange(5.0).untyped_storage()
        self.quantized = torch.quantize_per_tensor(torch.arange(4.0), 0.1, 0, torch.qint8)
        self.planners = {self}
    def act(self, observation):
        return self.net(observation)
torch.manual_seed(0)
net = Net()
print(*(keep_in_memory(one).digest for _ in range(2) for one in (net, Planner(net))))
"""


def test_an_object_of_tensors_and_sets_has_one_digest_in_all_processes():
    first, again = (run_python("-c", DIGESTS).stdout.split() for _ in range(2))
    assert first == again
    assert first[:2] == first[2:]
    assert len({*first}) == 2


class NamedSet(set):
    """A set that has attributes."""


def test_code_has_one_digest_wherever_it_was_typed():
    def made(file):
        space = {}
        exec(compile("class P:\n def act(self, observation): return 0", file, "exec"), space)
        return keep_in_memory(space["P"]()).digest

    assert made("/tmp/ipykernel_1/2.py") == made("/tmp/ipykernel_3/4.py")


def test_other_tensors_and_sets_have_other_digests():
    def digest(value):
        policy = Ending("nowhere", None)
        policy.value = value
        return keep_in_memory(policy).digest

    left, right = NamedSet({1, 2}), NamedSet({1, 2})
    left.name, right.name = "left", "right"
    values = [
        torch.zeros(4), torch.zeros(2, 2), torch.zeros(4, dtype=torch.int32), -torch.zeros(4),
        torch.tensor(0.0), torch.nn.Parameter(torch.zeros(4)), torch.eye(2).to_sparse(),
        torch.zeros(4, device="meta"), {1, 2}, {1, 3}, {"1", 2}, frozenset({1, 2}), {Ending},
        "0" * 32, "f" * 32, left, right,
    ]  # fmt: skip
    assert len({*map(digest, values)}) == len(values)
    transposed = torch.arange(4.0).reshape(2, 2).T
    assert digest(transposed) == digest(transposed.contiguous())
