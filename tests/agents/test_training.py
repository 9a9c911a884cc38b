"""A training that is broken off and resumed ends in the same bits."""

import shutil
import struct
from dataclasses import replace

import pytest
from tensorboardX.proto import event_pb2

import minitouch_bench as mt
from minitouch_bench.agents.config import PhaseConfig
from minitouch_bench.agents.curiosity import CURIOSITIES
from minitouch_bench.agents.training_directory import run_training
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.policies.native import load_native
from minitouch_bench.policies.policy import PolicySource
from minitouch_bench.policies.sources import TRAINED_FILE
from tests.agents.trainings import CONFIG, break_off, outcome, rows


def test_it_leaves_two_policies_and_its_curves(undisturbed):
    found = rows(undisturbed)
    assert [int(row["step"]) for row in found] == list(range(5, 51, 5))
    assert [row["phase"] for row in found] == ["exploration"] * 6 + ["task"] * 4
    evaluated = [int(row["step"]) for row in found if row["evaluation_success"]]
    assert evaluated == [40]
    page = (undisturbed / "report.html").read_text()
    assert "<figcaption>Touch share</figcaption>" in page
    assert "<h1>Pushing, hac, seed 0</h1>" in page
    for name in ("exploration", "final"):
        content = (undisturbed / f"{name}.safetensors").read_bytes()
        load_native(PolicySource("native", "x", name, content=content))


def test_its_events_are_tensorboard_s(undisturbed):
    (file,) = (undisturbed / "events").iterdir()
    assert ".tfevents." in file.name
    content, events = file.read_bytes(), []
    while content:
        (length,) = struct.unpack_from("<Q", content)
        events.append(event_pb2.Event.FromString(content[12 : 12 + length]))
        content = content[16 + length :]
    assert events[0].file_version == "brain.Event:2"
    assert [event.step for event in events[1:]] == list(range(5, 51, 5))
    tags = {value.tag for value in events[-1].summary.value}
    assert {"task/touch_share", "task/critic_loss"} <= tags


# In both phases, or before the first checkpoint.
@pytest.mark.parametrize(("steps", "kill"), [([17, 24], True), ([17, 24], False), ([6], True)])
def test_resumed_it_ends_in_the_same_bits(tmp_path, undisturbed, steps, kill):
    for step in steps:
        break_off(tmp_path, step, kill=kill)
    with (tmp_path / "progress.csv").open("a") as file:
        file.write("edited, or what a kill left of a row")
    assert run_training(CONFIG, tmp_path, resume=True, device="cpu")
    assert outcome(tmp_path) == outcome(undisturbed)


SLOW = [pytest.param(method, 3, marks=pytest.mark.slow) for method in CURIOSITIES]


# Without keypoints the task phase goes on with the networks of the exploration; sac has one phase.
@pytest.mark.parametrize(("method", "updates"), [("hac", 0), ("sac", 0), ("sac", 3), *SLOW])
def test_every_method_is_resumed_in_both_phases(tmp_path, method, updates):
    phase = replace(CONFIG.task_phase, keypoint_updates=updates)
    config = replace(CONFIG, method=method, evaluate_every=0, task_phase=phase)
    quiet, stopped = (tmp_path / name for name in ("quiet", "stopped"))
    for step in (14, 24):
        break_off(stopped, step, config)
    for directory in (quiet, stopped):
        assert run_training(config, directory, resume=True, device="cpu")
    assert (quiet / TRAINED_FILE).read_bytes() == (stopped / TRAINED_FILE).read_bytes()
    if method != "sac":  # which has no exploration policy
        assert outcome(quiet) == outcome(stopped)


@pytest.mark.parametrize(("explored", "trained"), [(30, 10), (30, 0), (20, 0)])
def test_it_can_be_made_longer(tmp_path, undisturbed, explored, trained):
    shorter = replace(
        CONFIG,
        exploration=replace(CONFIG.exploration, steps=explored),
        task_phase=replace(CONFIG.task_phase, steps=trained),
    )
    assert run_training(shorter, tmp_path, device="cpu")
    assert run_training(CONFIG, tmp_path, resume=True, device="cpu")
    assert outcome(tmp_path) == outcome(undisturbed)


def test_exploration_alone_leaves_both_policies(tmp_path):
    short = {"random_steps": 4, "exploration": {"steps": 8}, "sac": {"batch_size": 4}}
    found = mt.train("playing", "rnd", settings=short, output=tmp_path, device="cpu")
    assert found == tmp_path
    _, (exploration, final) = outcome(tmp_path)
    assert final == exploration


def test_training_episodes_can_be_shorter_than_the_task_s(tmp_path):
    config = replace(CONFIG, task="playing", episode_steps=3, checkpoint_every=50)
    assert run_training(config, tmp_path, device="cpu")
    assert sum(int(row["episodes"]) for row in rows(tmp_path)) == config.steps // 3


def test_other_settings_are_not_mixed_in(undisturbed):
    for phase in ({"exploration": PhaseConfig(31)}, {"task_phase": PhaseConfig(19)}):
        with pytest.raises(RunDirectoryError):
            run_training(replace(CONFIG, **phase), undisturbed, resume=True)


def test_a_mistake_leaves_the_directory_free(tmp_path):
    with pytest.raises(UsageError, match="typo"):
        run_training(replace(CONFIG, objects="typo"), tmp_path, device="cpu")
    with pytest.raises(UsageError, match="is not a Minari dataset"):
        run_training(replace(CONFIG, dataset="typo"), tmp_path, device="cpu")
    break_off(tmp_path, 0)


def test_stopped_before_its_first_row_it_leaves_no_page(tmp_path):
    break_off(tmp_path, 6, kill=True)
    break_off(tmp_path, 0)
    assert not (tmp_path / "progress.csv").exists()
    assert not (tmp_path / "report.html").exists()


def test_the_policy_of_a_shorter_training_does_not_stand_for_the_longer(undisturbed, tmp_path):
    directory = tmp_path / "longer"
    shutil.copytree(undisturbed, directory)
    policy = (directory / "final.safetensors").read_bytes()
    break_off(directory, 0, replace(CONFIG, task_phase=replace(CONFIG.task_phase, steps=30)))
    assert not (directory / "final.safetensors").exists()
    assert (directory / "final_50_steps.safetensors").read_bytes() == policy
