"""LeRobot's environments and datasets; `make test-lerobot` runs what needs LeRobot itself."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

import minitouch_bench as mt
from minitouch_bench.commands.record import RECORDING_SUITE, record
from minitouch_bench.policies.lerobot import INSTRUCTIONS
from minitouch_bench.policies.scripted import make_controller
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.runs.plan import Plan
from tests.altered import ROOT

FOLDER = ROOT / "integrations" / "lerobot"
PAGE = ROOT / "docs" / "how-to" / "lerobot.md"
SUITE = "minitouch"
OF_LEROBOT = {"lerobot_new_rollout": True}
"""The option with which LeRobot begins each rollout."""
INSTALL = "make test-lerobot has an environment with LeRobot"


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


@pytest.mark.parametrize("task_id", range(len(PROTOCOL.tasks)))
def test_a_task_has_the_form_that_lerobot_reads(made, task_id):
    vector, task = made[task_id], PROTOCOL.tasks[task_id]
    assert isinstance(vector, SyncVectorEnv)
    assert vector.num_envs == 2
    assert vector.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert vector.metadata["render_fps"] > 0
    assert vector.call("task") == (task.name,) * 2
    assert vector.call("task_description") == (INSTRUCTIONS[task.name],) * 2
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


def test_tasks_are_selected_by_name_and_keep_their_ids_and_processes_give_the_same(hub, made):
    vectors = hub.make_env(2, use_async_envs=True, cfg=only("pick-up, pushing"))[SUITE]
    assert list(vectors) == [1, 3]
    for task_id, task in ((1, "pushing"), (3, "pick-up")):
        vector = vectors[task_id]
        assert isinstance(vector, AsyncVectorEnv)
        assert vector.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
        assert vector.call("task") == (task,) * 2
        assert vector.single_action_space.shape == (4,)
        found, _ = vector.reset(seed=[5, 6], options=OF_LEROBOT)
        expected, _ = made[task_id].reset(seed=[5, 6])
        assert all(np.array_equal(found[key], expected[key]) for key in expected)
        vector.close()


def run(program, *arguments, directory):
    """Run a program of this environment as a user does who has no clone."""
    done = subprocess.run(
        [Path(sys.executable).with_name(program), *arguments],
        cwd=directory,
        env={**os.environ, "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done


def shown(program):
    """Return the arguments of a program's command as the page shows them."""
    (command,) = re.findall(rf"^{program}((?:.*\\\n)+.*)$", PAGE.read_text(), re.M)
    return command.replace("\\\n", " ").split()


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Two recorded episodes, in a folder where they have the page's name."""
    pytest.importorskip("lerobot.datasets", reason=INSTALL)
    folder = tmp_path_factory.mktemp("lerobot")
    record(
        "scripted", "pushing", output=folder / "data/pushing", episodes=2, dataset_format="lerobot"
    )
    return folder


def test_lerobots_own_loader_reads_what_was_recorded(dataset):
    from lerobot.datasets import LeRobotDataset

    frames = LeRobotDataset("minitouch/pushing", root=dataset / "data" / "pushing")
    assert (frames.num_episodes, frames.meta.video_keys, frames.fps) == (2, [], 4)
    names = frames.meta.features["observation.state"]["names"]
    assert (names[:3], names[-1]) == (["x", "y", "z"], "right_force_z")
    environment = mt.make("pushing")
    begins = [row["dataset_from_index"] for row in frames.meta.episodes]
    for begin, spec in zip(begins, Plan(RECORDING_SUITE, ("pushing",), 2, 0).specs(), strict=True):
        observation, _ = environment.reset(seed=spec.seed)
        frame = frames[begin]
        seen = (frame["observation.image"] * 255).round().numpy().astype(np.uint8)
        assert np.array_equal(seen, np.repeat(observation["image"], 3, axis=0))
        assert np.array_equal(frame["observation.state"], observation["touch"])
        assert frame["task"] == INSTRUCTIONS["pushing"]
        observation, _, _, _, _ = environment.step(frame["action"].numpy())
        assert np.array_equal(frames[begin + 1]["observation.state"], observation["touch"])
    last = frames[len(frames) - 1]
    assert (last["next.done"].item(), last["next.success"].item()) == (True, True)
    assert last["next.reward"].item() == 25.0
    environment.close()


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_policy_that_lerobot_trained_is_evaluated_verified_and_submitted(dataset):
    small = ["--policy.dim_model=64", "--policy.n_heads=2", "--policy.dim_feedforward=64"]
    brief = ["--steps=20", "--save_freq=20", "--batch_size=2", "--num_workers=0"]
    run("lerobot-train", *shown("lerobot-train"), *small, *brief, directory=dataset)
    policy = "outputs/train/act_pushing"
    digests = set()
    for name in ("first", "second"):
        played = ("--suite", "smoke", "--tasks", "pushing", "--episodes", "2", "--output", name)
        run("minitouch-bench", "evaluate", policy, *played, directory=dataset)
        facts = json.loads((dataset / name / "run.json").read_text())
        assert (facts["header"]["policy"]["kind"], facts["header"]["isolation"]) == (
            "lerobot",
            "sandbox",
        )
        digests.add(facts["digest"])
    assert len(digests) == 1
    run("minitouch-bench", "verify", "first", "--rerun", "1", directory=dataset)
    submit = ("submit", policy, "--name", "act", "--training-steps", "20", "--learner", "ACT")
    run("minitouch-bench", *submit, directory=dataset)
    run("minitouch-bench", "leaderboard", "check", "act", directory=dataset)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_lerobot_eval_finds_the_environments_by_the_distributions_name(tmp_path):
    pytest.importorskip("lerobot.scripts.lerobot_eval", reason=INSTALL)
    arguments = shown("lerobot-eval")
    run("lerobot-eval", *arguments, "--output_dir=evaluated", directory=tmp_path)
    result = json.loads((tmp_path / "evaluated" / "eval_info.json").read_text())
    assert result["overall"]["n_episodes"] == 2
    assert list(result["per_group"]) == [SUITE]
    assert len(list((tmp_path / "evaluated").rglob("*.mp4"))) == 2
