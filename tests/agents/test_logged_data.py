import json
import os
import resource

import gymnasium
import h5py
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
from minitouch_bench.workflows import TrainingProgress
from minitouch_bench.workflows.training import run_training
from tests.agents.logs import LENGTHS, write_log


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
    with pytest.raises(UsageError, match="is not a Minari dataset"):
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
    with pytest.raises(UsageError, match="observations of another kind"):
        fill_from_log(Replay(100, 11, 4, compress=True), tmp_path / "log", 4)


# A dataset of a stranger


def spoiled(path, change):
    """Write a dataset and let ``change`` spoil its data."""
    write_log(path, dense=True)
    with h5py.File(path / "main_data.hdf5", "r+") as file:
        change(file)
    return path


def put(name, value):
    def change(file):
        del file[f"episode_1/{name}"]
        file[f"episode_1/{name}"] = value

    return change


def declare(name, shape, dtype, **storage):
    """An array without content, of which only the shape is there."""

    def change(file):
        del file[f"episode_1/{name}"]
        file.create_dataset(f"episode_1/{name}", shape, dtype, **storage)

    return change


def spoil(name, index, value):
    def change(file):
        file[f"episode_1/{name}"][index] = value

    return change


def more_episodes(file):
    file["episode_2"] = h5py.ExternalLink("/etc/hostname", "/")


def names_of_one(file):
    """An episode under many names."""
    for index in range(2, 200):
        file[f"episode_{index}"] = file["episode_1"]


def virtual(file):
    layout = h5py.VirtualLayout((7, 4), "f4")
    layout[:] = h5py.VirtualSource("other.hdf5", "actions", (7, 4))
    del file["episode_1/actions"]
    file["episode_1"].create_virtual_dataset("actions", layout)


SPOILED = {
    "rewards too short": put("rewards", np.zeros(3)),
    "no rewards": lambda file: file["episode_1"].pop("rewards"),
    "actions without an axis": put("actions", np.float32(0.5)),
    "actions of text": put("actions", np.full((7, 4), "x", "S1")),
    "no actions": lambda file: file["episode_1"].pop("actions"),
    "an empty episode": put("actions", np.zeros((0, 4), "f4")),
    "infos that are an array": put("infos", np.zeros(8)),
    "a success too many": put("infos/is_success", np.zeros(20)),
    "images of float": put("observations/image", np.zeros((8, 1, 84, 84), "f4")),
    "26 GB": declare("observations/image", (3_700_000, 1, 84, 84), "u1", chunks=(1, 1, 84, 84)),
    "26 GB of every array": declare("actions", (10**9, 4), "f4", chunks=(1, 4)),
    "a chunk of gigabytes": declare(
        "actions", (7, 4), "f4", chunks=(2**27, 4), maxshape=(None, 4), compression="gzip"
    ),
    "nan": spoil("actions", (2, 1), np.nan),
    "infinity": spoil("rewards", 2, np.inf),
    "1e30": spoil("observations/touch", (2, 1), 1e30),
    "an action beyond 1": spoil("actions", (2, 1), 1.5),
    "an episode elsewhere": more_episodes,
    "actions elsewhere": lambda file: (
        file["episode_1"].pop("actions"),
        file["episode_1"].__setitem__("actions", h5py.ExternalLink("other.hdf5", "actions")),
    ),
    "a soft link": lambda file: (
        file["episode_1"].pop("actions"),
        file["episode_1"].__setitem__("actions", h5py.SoftLink("/episode_0/actions")),
    ),
    "bytes of another file": declare(
        "actions", (7, 4), "f4", external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)]
    ),
    "a virtual array": virtual,
    "more names than episodes": names_of_one,
}


@pytest.mark.parametrize("name", SPOILED)
def test_a_spoiled_dataset_is_refused_in_one_line(tmp_path, name):
    path = spoiled(tmp_path / "log", SPOILED[name])
    if name in ("an episode elsewhere", "more names than episodes"):
        episodes = 3 if name == "an episode elsewhere" else 200
        metadata = json.loads((path / "metadata.json").read_text())
        (path / "metadata.json").write_text(json.dumps(metadata | {"total_episodes": episodes}))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(UsageError) as refused:
        fill_from_log(Replay(100, 11, 4, compress=True), path, 4)
    assert len(str(refused.value).splitlines()) == 1
    assert len(str(refused.value)) < 400
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) < 2**20  # kB


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "{}", "nonsense", '{"total_episodes": "many"}', '{"total_episodes": 1000000000}',
        '{"total_episodes": -1}', '{"total_episodes": 2, "data_format": "arrow"}', "[" * 100_000,
    ],
)  # fmt: skip
def test_odd_metadata_are_refused_in_one_line(tmp_path, text):
    write_log(tmp_path / "log")
    (tmp_path / "log" / "metadata.json").write_text(text)
    with pytest.raises(UsageError, match="is not a Minari dataset") as refused:
        fill_from_log(Replay(100, 11, 4, compress=True), tmp_path / "log", 4)
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize("name", ["metadata.json", "main_data.hdf5"])
def test_nobody_waits_for_a_pipe(tmp_path, name):
    write_log(tmp_path / "log")
    (tmp_path / "log" / name).unlink()
    os.mkfifo(tmp_path / "log" / name)
    with pytest.raises(UsageError, match="no plain file"):
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
        exploration=PhaseConfig(8),
        task_phase=PhaseConfig(5),
        sac=SacConfig(batch_size=4),
        curiosity=CuriosityConfig(width=0.25),
    )


def test_exploration_learns_from_the_log_alone_and_the_task_from_the_world(tmp_path):
    config = config_with_log(tmp_path)
    rows, broken = [], tmp_path / "broken"
    shown = TrainingProgress(row=rows.append)
    assert run_training(config, tmp_path / "run", device="cpu", callbacks=shown)
    assert [row.step for row in rows] == [5, 8, 10, 13]  # no row is of both phases
    assert [row.phase for row in rows] == ["exploration"] * 2 + ["task"] * 2
    assert all(row.critic_loss is not None for row in rows)
    for row in rows:
        assert [row.touch_share is None, row.task_reward is None] == [row.phase != "task"] * 2

    asked = iter([False] * 7 + [True])
    stopped = TrainingProgress(should_stop=lambda: next(asked))
    assert not run_training(config, broken, device="cpu", callbacks=stopped)
    assert run_training(config, broken, resume=True, device="cpu", callbacks=shown)
    files = [tmp_path / name / "final.safetensors" for name in ("run", "broken")]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_sac_acts_from_the_first_step_with_the_log_in_its_memory(tmp_path):
    config = config_with_log(tmp_path, "sac")
    assert run_training(config, tmp_path / "run", device="cpu")
    memory, log_alone = (Replay(config.replay_size, 11, 4, compress=True) for _ in range(2))
    CheckpointFiles(tmp_path / "run").load(memory)
    fill_from_log(log_alone, tmp_path / "log", 4)
    assert memory.rows == log_alone.rows + 1 + config.steps
    assert memory.state()["successes"] == log_alone.state()["successes"]
