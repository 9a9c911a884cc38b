"""A training directory that somebody prepared: nothing outside it is written, and nobody waits."""

import math
import os
import shutil
import signal
import zipfile
import zlib
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
import torch

from minitouch_bench.agents import checkpoint, progress
from minitouch_bench.errors import (
    InfrastructureError,
    MiniTouchError,
    RunDirectoryError,
    UsageError,
)
from minitouch_bench.workflows.training import run_training
from tests.agents.test_training import break_off, outcome
from tests.agents.trainings import CONFIG, stop_at_once


@pytest.fixture(scope="module")
def broken_off(tmp_path_factory):
    directory = tmp_path_factory.mktemp("broken-off") / "run"
    break_off(directory, 25, kill=False, resume=False)
    return directory


@pytest.fixture
def prepared(broken_off, tmp_path):
    shutil.copytree(broken_off, tmp_path / "run")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear diary")
    return tmp_path / "run"


@pytest.fixture(autouse=True)
def nobody_waits():
    def too_long(*_):
        raise AssertionError("it hangs")

    before = signal.signal(signal.SIGALRM, too_long)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def mine(directory):
    return directory.parent / "mine" / "letter.txt"


def symbolic_link(file, target):
    file.symlink_to(target)


def second_name(file, target):
    os.link(target, file)


WRITTEN = ("replay.bin", "checkpoint.pt", "progress.csv")


@pytest.mark.parametrize("name", WRITTEN)
@pytest.mark.parametrize("plant", [symbolic_link, second_name])
def test_nothing_is_written_through_a_link(prepared, name, plant):
    shutil.copy(prepared / name, mine(prepared))
    content = mine(prepared).read_bytes()
    (prepared / name).unlink()
    plant(prepared / name, mine(prepared))
    with suppress(RunDirectoryError):  # or the name is given to a new file
        assert run_training(CONFIG, prepared, resume=True, device="cpu")
        assert plant is second_name
    assert mine(prepared).read_bytes() == content


@pytest.mark.parametrize("name", ["replay.bin", "progress.csv"])
def test_a_new_training_writes_through_no_link_either(tmp_path, name):
    (tmp_path / "run").mkdir()
    (tmp_path / "mine").mkdir()
    mine(tmp_path / "run").write_text("dear diary")
    (tmp_path / "run" / name).symlink_to(mine(tmp_path / "run"))
    with pytest.raises(RunDirectoryError):
        run_training(CONFIG, tmp_path / "run", device="cpu")
    assert mine(tmp_path / "run").read_text() == "dear diary"


def test_events_are_written_into_no_other_folder(prepared):
    shutil.rmtree(prepared / "events", ignore_errors=True)
    (prepared / "events").symlink_to(mine(prepared).parent)
    with pytest.raises(RunDirectoryError, match="events"):
        stop_at_once(prepared)
    assert [file.name for file in mine(prepared).parent.iterdir()] == ["letter.txt"]


@pytest.mark.parametrize("name", [*WRITTEN, "config.toml"])
def test_nobody_waits_for_a_pipe(prepared, name):
    (prepared / name).unlink()
    os.mkfifo(prepared / name)
    with pytest.raises(MiniTouchError, match="no plain file"):
        run_training(CONFIG, prepared, resume=True, device="cpu")


# A training that diverges

DIVERGING = replace(
    CONFIG,
    exploration=replace(CONFIG.exploration, learning_rate=1e6),
    updates_per_step=1.0,
    evaluate_every=0,
)


def test_a_training_that_diverges_says_so(tmp_path):
    with pytest.raises(UsageError, match=r"diverged after step \d+: the action .* NaN") as stopped:
        run_training(DIVERGING, tmp_path / "run", device="cpu")
    assert "smaller learning_rate" in str(stopped.value)


def test_a_policy_that_diverges_after_its_last_action_is_not_kept(tmp_path):
    late = replace(
        CONFIG,
        random_steps=CONFIG.steps - 1,
        updates_per_step=20.0,
        evaluate_every=0,
        task_phase=replace(CONFIG.task_phase, learning_rate=1e6),
    )
    with pytest.raises(UsageError, match="diverged after step 50: a weight of the policy is NaN"):
        run_training(late, tmp_path / "run", device="cpu")
    assert not (tmp_path / "run" / "final.safetensors").exists()


def test_rows_of_a_training_that_diverges_are_not_damaged(tmp_path):
    file = tmp_path / "progress.csv"
    row = progress.Tally().row(5, "task", None, 1.0)
    progress.append_row(file, replace(row, critic_loss=math.inf, value=-math.inf))
    before = file.read_bytes()
    progress.cut_rows(file, 5)
    assert file.read_bytes() == before
    progress.append_row(file, replace(row, touch_share=math.inf))
    with pytest.raises(RunDirectoryError, match="a row of it is damaged"):
        progress.cut_rows(file, 5)


# A full disk


@pytest.fixture(scope="module")
def quiet(tmp_path_factory):
    directory = tmp_path_factory.mktemp("quiet")
    assert run_training(CONFIG, directory, device="cpu")
    return directory


@pytest.mark.parametrize("writer", [(checkpoint, "write_file"), (progress, "append_bytes")])
@pytest.mark.parametrize("kept", [0, 21])
def test_a_full_disk_keeps_the_last_checkpoint_and_says_how_to_go_on(
    quiet, tmp_path, monkeypatch, writer, kept
):
    """``kept``: the step of the last checkpoint; there is one at every seventh step."""
    module, name = writer
    write, calls = getattr(module, name), []

    def fill(path, content):
        calls.append(path)
        # A row is written at every fifth step: after step 21 the fifth is the next.
        if len(calls) > (kept // 7 if name == "write_file" else kept // 5):
            raise RunDirectoryError(f"{path} cannot be written: No space left on device")
        write(path, content)

    monkeypatch.setattr(module, name, fill)
    with pytest.raises(InfrastructureError) as full:
        run_training(CONFIG, tmp_path / "run", device="cpu")
    reason, advice = str(full.value).splitlines()
    assert "No space left on device" in reason
    assert advice.startswith(f"The checkpoint of step {kept}" if kept else "There is no checkpoint")
    assert "--resume" in advice
    assert (tmp_path / "run" / "checkpoint.pt").exists() == bool(kept)
    monkeypatch.undo()
    assert run_training(CONFIG, tmp_path / "run", resume=True, device="cpu")
    assert outcome(tmp_path / "run") == outcome(quiet)


# What a checkpoint says


def changed(directory, change):
    """Write the checkpoint again after ``change`` has spoiled what it says."""
    state = torch.load(directory / "checkpoint.pt", weights_only=True)
    change(state)
    torch.save(state, directory / "checkpoint.pt")


def put(*path_and_value):
    *path, last, value = path_and_value

    def change(state):
        for key in path:
            state = state[key]
        state[last] = value

    return change


CHANGES = {
    "no step": lambda state: state.pop("step"),
    "a step of text": put("step", "10"),
    "a negative episode": put("episode", -1),
    "rows that are not there": put("replay", "rows", 10**18),
    "rows of the memory's other size": put("replay", "_touch", torch.zeros(5, 3)),
    "a tensor that is larger than its storage": put(
        "replay", "lengths", torch.zeros(1, dtype=torch.int32).expand(10**10)
    ),
    "lengths below 0": lambda state: state["replay"]["lengths"].neg_(),
    "lengths of gigabytes": lambda state: state["replay"]["lengths"].fill_(2**30),
    "an episode of the wrong length": put("replay", "episode_start", -(10**6)),
    "no row with an action": lambda state: state["replay"]["_last"].fill_(True),
    "successes of another kind": put("replay", "successes", [(5, 3)]),
    "images of another shape": put("replay", "image_shape", (1, 10**6, 10**6)),
    "weights of another shape": lambda state: state["learner"]["sac"].update(
        {name: torch.zeros(2) for name in list(state["learner"]["sac"])[:1]}
    ),
    "no optimizer": lambda state: state["learner"]["optimizers"].pop("actor"),
    "chance of another kind": put("learner", "rng", {"bit_generator": "x"}),
    "sums of another kind": put("tally", {"nothing": 1}),
    "actions that are no numbers": lambda state: state["replay"]["_action"].fill_(float("nan")),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_checkpoint_that_says_what_cannot_be_is_refused(prepared, name):
    changed(prepared, CHANGES[name])
    with pytest.raises(RunDirectoryError, match=r"checkpoint\.pt cannot be resumed from") as error:
        run_training(CONFIG, prepared, resume=True, device="cpu")
    assert len(str(error.value).splitlines()) <= 2


def test_a_checkpoint_that_unpacks_to_more_is_refused(prepared, tmp_path):
    file = prepared / "checkpoint.pt"
    with zipfile.ZipFile(file) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    with pytest.raises(RunDirectoryError, match="checkpoint"):
        stop_at_once(prepared)


def test_a_flipped_bit_is_found(prepared):
    for name in ("checkpoint.pt", "replay.bin"):
        whole = (prepared / name).read_bytes()
        for place in np.random.default_rng(0).integers(len(whole), size=5):
            content = bytearray(whole)
            content[place] ^= 16
            (prepared / name).write_bytes(content)
            try:
                stop_at_once(prepared)
            except RunDirectoryError:
                continue
            # Between the members of the archive a bit means nothing.
            assert name == "checkpoint.pt"
        (prepared / name).write_bytes(whole)


def test_pictures_that_unpack_to_more_are_refused(prepared):
    state = torch.load(prepared / "checkpoint.pt", weights_only=True)
    first = int(state["replay"]["lengths"][0])
    bomb = zlib.compress(bytes(2**30), 9)
    content = (prepared / "replay.bin").read_bytes()
    (prepared / "replay.bin").write_bytes(bomb + content[first:])
    state["replay"]["lengths"][0] = len(bomb)
    state["images"] += len(bomb) - first
    torch.save(state, prepared / "checkpoint.pt")
    with pytest.raises(RunDirectoryError, match="checkpoint"):
        stop_at_once(prepared)
