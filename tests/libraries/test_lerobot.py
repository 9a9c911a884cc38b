"""The environments for LeRobot: as vector environments, and in LeRobot itself where it is."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

import minitouch_bench as mt
from minitouch_bench.policies.scripted import make_controller
from minitouch_bench.protocol.minitouch import PROTOCOL
from tests.altered import ROOT

FOLDER = ROOT / "examples" / "lerobot"
PAGE = ROOT / "docs" / "how-to" / "other-libraries.md"
SUITE = "minitouch"
OF_LEROBOT = {"lerobot_new_rollout": True}
"""The option with which LeRobot begins each rollout."""
INSTALL = "pip install 'lerobot[evaluation,dataset]>=0.6'"


@pytest.fixture(scope="module")
def hub():
    """``env.py``, imported by its path as LeRobot does, so that nobody can import it by name."""
    spec = importlib.util.spec_from_file_location("hub_env_someone", FOLDER / "env.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def made(hub):
    """All tasks, two environments each."""
    envs = hub.make_env(n_envs=2)
    yield envs[SUITE]
    for vector in envs[SUITE].values():
        vector.close()


def only(task):
    return SimpleNamespace(task=task)


def test_it_lists_the_tasks_of_the_protocol(hub):
    assert {name: task[:2] for name, task in hub.TASKS.items()} == {
        task.name: (task.gym_id, task.action_size) for task in PROTOCOL.tasks
    }


@pytest.mark.parametrize("task_id", range(len(PROTOCOL.tasks)))
def test_a_task_has_the_form_that_lerobot_reads(made, task_id):
    vector, task = made[task_id], PROTOCOL.tasks[task_id]
    assert isinstance(vector, SyncVectorEnv)
    assert vector.num_envs == 2
    assert vector.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert vector.metadata["render_fps"] > 0
    assert vector.call("task") == (task.name,) * 2
    assert all(" " in text for text in vector.call("task_description"))
    assert vector.call("_max_episode_steps") == (task.max_steps,) * 2

    observation, info = vector.reset(seed=[3, 4], options=OF_LEROBOT)
    assert observation in vector.observation_space
    assert (observation["pixels"].shape, observation["pixels"].dtype) == ((2, 84, 84, 3), np.uint8)
    assert (observation["agent_pos"].shape, observation["agent_pos"].dtype) == ((2, 11), np.float32)
    assert info["is_success"].tolist() == [False, False]
    environment = mt.make(task.name)
    own, _ = environment.reset(seed=4)
    environment.close()
    for channel in range(3):
        assert np.array_equal(observation["pixels"][1, :, :, channel], own["image"][0])
    assert np.array_equal(observation["agent_pos"][1], own["touch"])

    assert vector.single_action_space.shape == (5,)
    vector.action_space.seed(0)
    _, reward, terminated, truncated, info = vector.step(vector.action_space.sample())
    assert reward.tolist() == [0.0, 0.0]
    assert not (terminated | truncated).any()
    assert info["is_success"].shape == (2,)
    assert [frame.shape for frame in vector.call("render")] == [(240, 240, 3)] * 2


def test_a_success_is_in_the_final_info_and_the_next_episode_has_begun(hub):
    (vector,) = hub.make_env(2, cfg=only("opening"))[SUITE].values()
    vector.reset(seed=[0, 1])
    controller = make_controller(vector.envs[0].unwrapped)
    for _ in range(40):
        actions = np.stack([controller.act(), np.zeros(5, np.float32)])
        observation, reward, terminated, _, info = vector.step(actions)
        if terminated.any():
            break
    assert terminated.tolist() == [True, False]
    assert reward.tolist() == [25.0, 0.0]
    assert info["final_info"]["is_success"].tolist() == [True, False]
    assert info["is_success"].tolist() == [False, False]
    last, first = info["final_obs"][0]["agent_pos"], observation["agent_pos"][0]
    assert np.abs(last[:3] - first[:3]).max() > 0.01
    vector.close()


def test_processes_give_what_one_process_gives(hub, made):
    (vector,) = hub.make_env(2, use_async_envs=True, cfg=only("pushing"))[SUITE].values()
    assert isinstance(vector, AsyncVectorEnv)
    assert vector.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    found, _ = vector.reset(seed=[5, 6], options=OF_LEROBOT)
    expected, _ = made[1].reset(seed=[5, 6])
    assert all(np.array_equal(found[key], expected[key]) for key in expected)
    assert vector.call("task") == ("pushing",) * 2
    vector.close()


def test_tasks_are_selected_by_name_and_keep_their_ids(hub):
    vectors = hub.make_env(cfg=only("pick-up, pushing"))[SUITE]
    assert [vector.call("task") for vector in vectors.values()] == [("pushing",), ("pick-up",)]
    assert list(vectors) == [1, 3]
    assert vectors[1].single_action_space.shape == (4,)
    for vector in vectors.values():
        vector.close()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_lerobot_eval_runs_as_the_page_says(tmp_path):
    pytest.importorskip("lerobot.scripts.lerobot_eval", reason=INSTALL)
    shutil.copytree(FOLDER, tmp_path / "minitouch_env")
    (command,) = re.findall(r"^PYTHONPATH=\. (lerobot-eval(?:.*\\\n)+.*)$", PAGE.read_text(), re.M)
    arguments = command.replace("\\\n", " ").split()
    program = Path(sys.executable).with_name(arguments[0])
    done = subprocess.run(
        [program, *arguments[1:], "--output_dir=evaluated"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([".", str(ROOT)])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    result = json.loads((tmp_path / "evaluated" / "eval_info.json").read_text())
    assert result["overall"]["n_episodes"] == 2
    assert list(result["per_group"]) == [SUITE]
    assert len(list((tmp_path / "evaluated").rglob("*.mp4"))) == 2
