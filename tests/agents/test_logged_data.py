from dataclasses import replace
from pathlib import Path

import gymnasium
import minari
import numpy as np
import pytest
from minari.data_collector.episode_buffer import EpisodeBuffer
from minari.dataset.minari_storage import MinariStorage

from minitouch_bench.agents.checkpoint import CheckpointFiles
from minitouch_bench.agents.config import CuriosityConfig, PhaseConfig, SacConfig, TrainingConfig
from minitouch_bench.agents.logged_data import fill_from_log
from minitouch_bench.agents.replay import Replay
from minitouch_bench.errors import UsageError
from minitouch_bench.workflows.train import TrainingRequest, train

LENGTHS = (4, 7)


def write_log(path: Path, touch_size=11, dense=False):
    spaces = gymnasium.spaces
    observation = spaces.Dict(
        {
            "image": spaces.Box(0, 255, (1, 84, 84), np.uint8),
            "touch": spaces.Box(-50, 50, (touch_size,), np.float32),
        }
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


def test_the_memory_holds_every_recorded_step(tmp_path):
    write_log(tmp_path / "log")
    replay = Replay(100, 11, 4, compress=True)
    fill_from_log(replay, tmp_path / "log", 4)
    assert replay.rows == sum(LENGTHS) + len(LENGTHS)
    assert len(replay.episode_actions()) == LENGTHS[-1]


@pytest.mark.parametrize("dense", [False, True])
def test_a_success_is_what_the_log_calls_one(tmp_path, dense):
    write_log(tmp_path / "log", dense=dense)
    replay = Replay(100, 11, 4, compress=True)
    fill_from_log(replay, tmp_path / "log", 4)
    assert replay.state()["successes"] == [(0, 4), (5, 12)]


def test_a_log_of_another_form_is_refused(tmp_path):
    write_log(tmp_path / "log", touch_size=3)
    with pytest.raises(UsageError, match="touch"):
        fill_from_log(Replay(100, 11, 4, compress=True), tmp_path / "log", 4)
    with pytest.raises(UsageError, match="no Minari dataset"):
        fill_from_log(Replay(100, 11, 4, compress=True), tmp_path / "nothing", 4)


def test_a_log_of_bare_numbers_is_refused(tmp_path):
    space = gymnasium.spaces.Box(-1, 1, (4,), np.float32)
    storage = MinariStorage.new(tmp_path / "log", space, space, jpeg_encoding=False)
    zeros = np.zeros((3, 4), np.float32)
    episode = EpisodeBuffer(
        observations=zeros, actions=zeros[1:], rewards=[0.0, 0.0], terminations=[False, True],
        truncations=[False, False],
    )  # fmt: skip
    storage.update_episodes([episode])
    storage.update_metadata({"dataset_id": "robot-v0", "minari_version": minari.__version__})
    with pytest.raises(UsageError, match="holds an episode with"):
        fill_from_log(Replay(100, 11, 4, compress=True), tmp_path / "log", 4)


def config_with_log(tmp_path, method="hac"):
    write_log(tmp_path / "log")
    return TrainingConfig(
        "pushing",
        method=method,
        log=str(tmp_path / "log"),
        updates_per_step=1.0,
        log_every=5,
        evaluate_every=0,
        checkpoint_every=4,
        exploration=PhaseConfig(10),
        task_phase=PhaseConfig(5),
        sac=SacConfig(batch_size=4),
        curiosity=CuriosityConfig(width=0.25),
    )


def test_exploration_learns_from_the_log_alone_and_the_task_from_the_world(tmp_path):
    config = config_with_log(tmp_path)
    rows = []
    once = TrainingRequest(config, tmp_path / "run", device="cpu", on_row=rows.append)
    assert train(once)
    assert [row.phase for row in rows] == ["exploration", "exploration", "task"]
    assert all(row.critic_loss is not None for row in rows)

    asked = iter([False] * 7 + [True])
    broken = replace(once, directory=tmp_path / "broken", should_stop=lambda: next(asked))
    assert not train(broken)
    assert train(replace(broken, resume=True, should_stop=lambda: False))
    files = [tmp_path / name / "final.safetensors" for name in ("run", "broken")]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_sac_acts_from_the_first_step_with_the_log_in_its_memory(tmp_path):
    config = config_with_log(tmp_path, "sac")
    assert train(TrainingRequest(config, tmp_path / "run", device="cpu"))
    memory, log_alone = (Replay(config.replay_size, 11, 4, compress=True) for _ in range(2))
    CheckpointFiles(tmp_path / "run").load(memory)
    fill_from_log(log_alone, tmp_path / "log", 4)
    assert memory.rows == log_alone.rows + 1 + config.steps
    assert memory.state()["successes"] == log_alone.state()["successes"]
