import socket
from dataclasses import replace

import gymnasium
import h5py
import minari
import numpy as np
import pytest
import torch
from minari.data_collector.episode_buffer import EpisodeBuffer
from minari.dataset.minari_storage import MinariStorage

import minitouch_bench as mt
from minitouch_bench.agents.config import PhaseConfig
from minitouch_bench.agents.memory import CheckpointFiles, ReplayMemory
from minitouch_bench.agents.training import fill_from_dataset
from minitouch_bench.agents.training_directory import run_training
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.engine import Callbacks
from minitouch_bench.protocol.minitouch import PUSHING
from tests.agents.trainings import CONFIG, break_off

LENGTHS = (4, 7)


def write_log(path, touch_size=11, dense=False):
    spaces = gymnasium.spaces
    observation = spaces.Dict(
        image=spaces.Box(0, 255, (1, 84, 84), np.uint8),
        touch=spaces.Box(-50, 50, (touch_size,), np.float32),
    )
    action = spaces.Box(-1, 1, (4,), np.float32)
    storage = MinariStorage.new(path, observation, action, jpeg_encoding=False)
    rng = np.random.default_rng(0)
    for length in LENGTHS:
        episode = EpisodeBuffer(
            observations={
                "image": rng.integers(0, 256, (length + 1, 1, 84, 84), dtype=np.uint8),
                "touch": rng.normal(size=(length + 1, touch_size)).astype(np.float32),
            },
            actions=rng.uniform(-1, 1, (length, 4)).astype(np.float32),
            rewards=[float(dense)] * (length - 1) + [25.0],
            terminations=[False] * (length - 1) + [True],
            truncations=[False] * length,
            infos={"is_success": np.arange(length + 1) == length} if dense else None,
        )
        storage.update_episodes([episode])
    storage.update_metadata({"dataset_id": "robot-v0", "minari_version": minari.__version__})


@pytest.mark.parametrize("dense", [False, True])
def test_the_memory_holds_every_recorded_step_and_success(tmp_path, dense):
    write_log(tmp_path / "log", dense=dense)
    memory = ReplayMemory(100, 11, 4)
    fill_from_dataset(memory, tmp_path / "log", PUSHING)
    assert memory.rows == sum(LENGTHS) + len(LENGTHS)
    assert len(memory.episode_actions()) == LENGTHS[-1]
    led = memory.state()["_led_to_success"].nonzero().flatten().tolist()
    assert led == [*range(4), *range(5, 12)]


def is_refused(path, words="is not a Minari dataset", capacity=100):
    """Check that a memory refuses a dataset in one line with these words."""
    with pytest.raises(UsageError, match=words) as refused:
        fill_from_dataset(ReplayMemory(capacity, 11, 4), path, PUSHING)
    assert len(str(refused.value).splitlines()) == 1


def test_a_log_of_another_form_or_larger_than_the_memory_is_refused(tmp_path):
    is_refused(tmp_path / "nothing")
    write_log(tmp_path / "log")
    is_refused(tmp_path / "log", "replay_size", capacity=10)
    write_log(tmp_path / "other", touch_size=3)
    is_refused(tmp_path / "other", "touch")


@pytest.mark.parametrize("address", ["http://127.0.0.1:1/log", "hf://a/b"])
def test_a_file_of_settings_names_no_server(tmp_path, monkeypatch, address):
    tried = []
    monkeypatch.setattr(socket.socket, "connect", lambda *given: tried.append(given))
    (tmp_path / "settings.toml").write_text(f"dataset = '{address}'")
    settings, output = tmp_path / "settings.toml", tmp_path / "run"
    with pytest.raises(UsageError, match="is not a Minari dataset"):
        mt.train("pushing", config=settings, output=output, device="cpu")
    assert tried == []


def put(name, value):
    def change(episode):
        del episode[name]
        episode[name] = value

    return change


def spoil(name, index, value):
    def change(episode):
        episode[name][index] = value

    return change


def without_steps(episode):
    for name in ("actions", "rewards", "terminations", "infos/is_success"):
        put(name, episode[name][:0])(episode)
    for name in ("image", "touch"):
        put(f"observations/{name}", episode[f"observations/{name}"][:1])(episode)


SPOILED = {
    "no control step": without_steps,
    "no rewards": lambda episode: episode.pop("rewards"),
    "actions of text": put("actions", np.full((7, 4), "x", "S1")),
    "a success too few": put("infos/is_success", np.zeros(6)),
    "images of float": put("observations/image", np.zeros((8, 1, 84, 84), "f4")),
    "nan": spoil("actions", (2, 1), np.nan),
    "1e30": spoil("observations/touch", (2, 1), 1e30),
    "an action beyond 1": spoil("actions", (2, 1), 1.5),
}


@pytest.mark.parametrize("name", SPOILED)
def test_a_spoiled_dataset_is_refused_in_one_line(tmp_path, name):
    write_log(tmp_path / "log", dense=True)
    with h5py.File(tmp_path / "log" / "main_data.hdf5", "r+") as file:
        SPOILED[name](file["episode_1"])
    is_refused(tmp_path / "log")


@pytest.mark.parametrize("text", ["", '{"total_episodes": "many"}'])
def test_odd_metadata_are_refused_in_one_line(tmp_path, text):
    write_log(tmp_path / "log")
    (tmp_path / "log" / "metadata.json").write_text(text)
    is_refused(tmp_path / "log")


def config_with_log(tmp_path, method="hac"):
    write_log(tmp_path / "log")
    phases = {"exploration": PhaseConfig(8), "task_phase": PhaseConfig(5)}
    how = {"method": method, "dataset": str(tmp_path / "log"), "evaluate_every": 0, **phases}
    return replace(CONFIG, checkpoint_every=4, **how)


def test_exploration_learns_from_the_log_alone_and_the_task_from_the_world(tmp_path):
    config, rows = config_with_log(tmp_path), []
    callbacks = Callbacks(row=rows.append)
    assert run_training(config, tmp_path / "run", device="cpu", callbacks=callbacks)
    assert [row.step for row in rows] == [5, 8, 10, 13]  # no row is of both phases
    assert [row.phase for row in rows] == ["exploration"] * 2 + ["task"] * 2
    assert all(row.critic_loss is not None for row in rows)
    for row in rows:
        assert [row.touch_share is None, row.task_reward is None] == [row.phase != "task"] * 2

    break_off(tmp_path / "broken", 7, config)
    assert run_training(config, tmp_path / "broken", resume=True, device="cpu")
    files = [tmp_path / name / "final.safetensors" for name in ("run", "broken")]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_sac_acts_from_the_first_step_with_the_log_in_its_memory(tmp_path):
    config = config_with_log(tmp_path, "sac")
    assert run_training(config, tmp_path / "run", device="cpu")
    memory, log_alone = (ReplayMemory(config.replay_size, 11, 4) for _ in range(2))
    CheckpointFiles(tmp_path / "run").load(memory)
    fill_from_dataset(log_alone, tmp_path / "log", PUSHING)
    assert memory.rows == log_alone.rows + 1 + config.steps
    ours, theirs = (one.state()["_led_to_success"] for one in (memory, log_alone))
    assert torch.equal(ours[: len(theirs)], theirs)
    assert not ours[len(theirs) :].any()
