"""Proof by doing: images in color and longer episodes are set in the protocol alone."""

import json

from minitouch_bench.perturbation import PolicyLimits
from minitouch_bench.protocol.minitouch import PROTOCOL
from tests.altered import copy_package, edit, python

CHANGES = {
    "minitouch.py": ("grey_weights=(2989, 5870, 1140),", "grey_weights=(),"),
    "tasks.py": ('name="playing",', 'name="playing",\n    max_steps=300,'),
}

MAKE_POLICY = """
import sys
from pathlib import Path
import minitouch_bench as mt
from minitouch_bench.perturbation import PolicyLimits
from minitouch_bench.policies.native import save_native
from minitouch_bench.policies.networks import TouchActor
environment = mt.make("playing")
observation, _ = environment.reset(seed=0)
image = observation["image"]
assert image.shape == (3, 84, 84) and environment.observation_space.contains(observation)
assert any((image[0] != channel).any() for channel in image[1:])
assert environment.spec.max_episode_steps == 300
assert PolicyLimits(load_timeout_s=1, act_timeout_s=2).cpu_s == 601
save_native(TouchActor(4), Path("policy.safetensors"))
"""


def test_a_variant_is_a_change_of_the_protocol_alone(tmp_path):
    package = copy_package(tmp_path)
    for name, change in CHANGES.items():
        edit(package / "protocol" / name, change)
    python(package, tmp_path, "-c", MAKE_POLICY)
    settings = ["--tasks", "playing", "--episodes", "1", "--workers", "1", "--output", "run"]
    command = ["-m", "minitouch_bench", "evaluate", "policy.safetensors"]
    python(package, tmp_path, *command, *settings)
    (episode,) = json.loads((tmp_path / "run" / "run.json").read_text())["episodes"]
    assert (episode["outcome"], episode["steps"]) == ("step_limit", 300)


def test_the_parts_of_the_touch_vector_are_all_of_it():
    spec = PROTOCOL.observation
    numbers = [*range(spec.touch_size)]
    assert numbers[spec.position] + numbers[spec.openings] + numbers[spec.forces] == numbers


def test_processor_time_is_what_the_longest_episode_may_take():
    longest = max(task.max_steps for task in PROTOCOL.tasks)
    assert PolicyLimits(load_timeout_s=7.0, act_timeout_s=0.5).cpu_s == 7 + longest / 2
