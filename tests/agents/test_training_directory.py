"""What a training finds in its directory: nothing is replaced, nothing outside it is written."""

import pickle
import shutil
from dataclasses import replace

import pytest
import torch

from minitouch_bench import files
from minitouch_bench.agents import memory, training
from minitouch_bench.agents.config import PhaseConfig
from minitouch_bench.agents.training_directory import run_training
from minitouch_bench.errors import (
    InfrastructureError,
    MiniTouchError,
    RunDirectoryError,
    UsageError,
)
from minitouch_bench.evaluation.engine import Callbacks
from tests.agents.trainings import CONFIG, KilledError, break_off, outcome
from tests.shapegen.conftest import subset


@pytest.fixture(scope="module")
def broken_off(tmp_path_factory):
    directory = tmp_path_factory.mktemp("broken-off") / "run"
    break_off(directory, 25)
    return directory


@pytest.fixture
def prepared(broken_off, tmp_path):
    return shutil.copytree(broken_off, tmp_path / "run")


def contents(directory):
    return {file: file.read_bytes() for file in directory.rglob("*") if file.is_file()}


@pytest.mark.parametrize("name", ["final.safetensors", "config.toml", "letter.txt"])
@pytest.mark.parametrize("resume", [True, False])
def test_what_another_training_or_a_user_left_is_not_replaced(prepared, name, resume):
    (prepared / name).write_text("dear diary")
    before = contents(prepared)
    with pytest.raises(RunDirectoryError) as refused:
        run_training(replace(CONFIG, seed=1), prepared, resume=resume, device="cpu")
    assert refused.value.exit_code == 6
    assert len(str(refused.value).splitlines()) <= 2
    if not resume:
        assert "--resume" in str(refused.value).splitlines()[1]
    elif name != "config.toml":
        assert "seed: 0 there, 1 asked for" in str(refused.value)
    assert contents(prepared) == before


def test_a_directory_without_settings_contains_no_training_to_resume(tmp_path):
    (tmp_path / "final.safetensors").write_text("dear diary")
    with pytest.raises(RunDirectoryError, match=r"final\.safetensors.*\n.*no training"):
        run_training(CONFIG, tmp_path, resume=True, device="cpu")
    assert [file.name for file in tmp_path.iterdir()] == ["final.safetensors"]


@pytest.mark.parametrize("line", ["seed = 0\n", 'objects = ""\n', "discount = 0.99\n"])
def test_a_resumed_training_has_every_setting_recorded(prepared, line):
    """A default in place of a missing line could make another training of it."""
    text = (prepared / "config.toml").read_text()
    assert text.count(line) == 1
    (prepared / "config.toml").write_text(text.replace(line, ""))
    with pytest.raises(RunDirectoryError, match=f"lacks .*{line.split()[0]}"):
        run_training(CONFIG, prepared, resume=True, device="cpu")


def test_events_are_written_into_no_other_folder(prepared):
    shutil.rmtree(prepared / "events", ignore_errors=True)
    mine = prepared.with_name("mine")
    mine.mkdir()
    (prepared / "events").symlink_to(mine)
    with pytest.raises(InfrastructureError, match="events"):
        break_off(prepared, 0)
    assert [*mine.iterdir()] == []


def test_a_fresh_training_replaces_one(prepared):
    config = (prepared / "config.toml").read_text()
    with pytest.raises(UsageError, match="--fresh"):
        run_training(CONFIG, prepared, resume=True, fresh=True, device="cpu")
    break_off(prepared, 0, replace(CONFIG, seed=1), resume=False, fresh=True)
    assert (prepared / "config.toml").read_text() != config


@pytest.mark.parametrize(
    ("changes", "word"),
    [({}, "letter.txt"), ({"objects": "typo"}, "typo"), ({"dataset": "nowhere"}, "nowhere")],
)
def test_a_fresh_training_that_is_refused_removes_nothing(prepared, changes, word):
    if not changes:
        (prepared / word).write_text("mine")
    before = contents(prepared)
    with pytest.raises(MiniTouchError, match=word):
        run_training(replace(CONFIG, **changes), prepared, fresh=True, device="cpu")
    assert contents(prepared) == before


def test_the_caller_s_settings_of_torch_change_nothing_and_stay(tmp_path, undisturbed):
    torch.set_default_dtype(torch.float64)
    try:
        with torch.no_grad():
            assert run_training(CONFIG, tmp_path / "run", device="cpu")
            assert not torch.is_grad_enabled()
        assert torch.get_default_dtype() is torch.float64
    finally:
        torch.set_default_dtype(torch.float32)
    assert outcome(tmp_path / "run") == outcome(undisturbed)


def test_a_training_is_not_resumed_with_other_objects(tmp_path):
    config = replace(CONFIG, objects=str(subset(tmp_path / "set", 3)))
    break_off(tmp_path / "run", 0, config)
    (tmp_path / "set").rename(tmp_path / "away")
    subset(tmp_path / "set", 4)
    with pytest.raises(RunDirectoryError, match="not the set of objects"):
        break_off(tmp_path / "run", 0, config)
    shutil.rmtree(tmp_path / "set")
    (tmp_path / "away").rename(tmp_path / "set")
    break_off(tmp_path / "run", 0, config)


def test_a_training_without_a_step_is_refused(tmp_path):
    none = replace(CONFIG, exploration=PhaseConfig(0), task_phase=PhaseConfig(0))
    with pytest.raises(UsageError, match="0 control steps"):
        run_training(none, tmp_path / "run", device="cpu")
    assert not (tmp_path / "run").exists()


def test_a_training_that_diverges_says_so(tmp_path):
    diverging = replace(CONFIG, exploration=replace(CONFIG.exploration, learning_rate=1e6))
    with pytest.raises(UsageError, match=r"diverged after step \d+: the action .* NaN") as stopped:
        run_training(diverging, tmp_path / "run", device="cpu")
    assert "smaller learning_rate" in str(stopped.value)


def test_a_policy_that_diverges_after_its_last_action_is_not_kept(tmp_path):
    how = {"learning_rate": 1e6, "updates_per_step": 20.0, "keypoint_updates": 0}
    late = replace(
        CONFIG,
        random_steps=CONFIG.steps - 1,
        evaluate_every=0,
        task_phase=replace(CONFIG.task_phase, **how),
    )
    with pytest.raises(UsageError, match="diverged after step 50: a weight of the policy is NaN"):
        run_training(late, tmp_path / "run", device="cpu")
    assert not (tmp_path / "run" / "final.safetensors").exists()


LONGER = replace(CONFIG, task_phase=replace(CONFIG.task_phase, steps=CONFIG.task_phase.steps + 5))


@pytest.mark.parametrize("config", [CONFIG, LONGER])
def test_a_finished_training_without_its_checkpoint_is_not_begun_again(prepared, config):
    (prepared / "final.safetensors").write_bytes(b"its policy")
    (prepared / "checkpoint.pt").unlink()
    before = sorted(prepared.iterdir())
    with pytest.raises(RunDirectoryError, match="without its checkpoint"):
        run_training(config, prepared, resume=True, device="cpu")
    assert sorted(prepared.iterdir()) == before


def test_a_training_that_cannot_be_made_longer_keeps_its_policy(prepared):
    (prepared / "final.safetensors").write_bytes(b"its policy")
    (prepared / "checkpoint.pt").write_bytes(b"damaged")
    with pytest.raises(RunDirectoryError, match="checkpoint"):
        run_training(LONGER, prepared, resume=True, device="cpu")
    assert (prepared / "final.safetensors").read_bytes() == b"its policy"


def test_a_replacement_that_is_broken_off_can_be_asked_for_again(prepared, monkeypatch):
    def killed(place):
        raise KilledError

    monkeypatch.setattr("shutil.rmtree", killed)  # the events go between other files
    with pytest.raises(KilledError):
        run_training(CONFIG, prepared, fresh=True, device="cpu")
    assert not (prepared / "checkpoint.pt").exists()
    monkeypatch.undo()
    break_off(prepared, 0, resume=False, fresh=True)


@pytest.mark.parametrize(
    "place",
    [
        (files, "config.toml", 0),
        (memory, "checkpoint.pt", 0),
        (training, "progress.csv", 4),
        (files, "report.html", 0),
    ],
)
def test_a_full_disk_keeps_the_last_checkpoint_and_says_how_to_go_on(
    undisturbed, tmp_path, monkeypatch, place
):
    module, name, kept = place  # how often the file is written before
    write, calls = module.write_file, []

    def fill(path, content):
        calls.append(path.name)
        if calls.count(name) > kept:
            raise RunDirectoryError(f"{path} cannot be written: No space left on device")
        write(path, content)

    monkeypatch.setattr(module, "write_file", fill)
    with pytest.raises(InfrastructureError, match=f"{name} .*No space .*\n.*--resume continues"):
        run_training(CONFIG, tmp_path / "run", device="cpu")
    assert (tmp_path / "run" / "checkpoint.pt").exists() == (
        name in ("progress.csv", "report.html")
    )
    monkeypatch.undo()
    assert run_training(CONFIG, tmp_path / "run", resume=True, device="cpu")
    assert outcome(tmp_path / "run") == outcome(undisturbed)


def flipped(content):
    """Return bytes of which one bit is another."""
    place = len(content) // 3
    return content[:place] + bytes([content[place] ^ 16]) + content[place + 1 :]


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("checkpoint.pt", lambda _: pickle.dumps([1, 2], protocol=2)),
        ("checkpoint.pt", lambda content: content[: len(content) // 2]),
        ("checkpoint.pt", flipped),
        ("replay.bin", lambda content: content[:-10]),
        ("replay.bin", flipped),
    ],
)
def test_a_damaged_checkpoint_is_named(prepared, name, damage):
    (prepared / name).write_bytes(damage((prepared / name).read_bytes()))
    with pytest.raises(RunDirectoryError, match=r"checkpoint\.pt"):
        run_training(CONFIG, prepared, resume=True, device="cpu")


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda state: state.update(version=0), "version 0"),
        (lambda state: state.pop("step"), "step"),
    ],
)
def test_a_checkpoint_of_another_form_is_refused(prepared, change, word):
    state = torch.load(prepared / "checkpoint.pt", weights_only=True)
    change(state)
    torch.save(state, prepared / "checkpoint.pt")
    with pytest.raises(RunDirectoryError, match=rf"checkpoint\.pt cannot be .*{word}") as refused:
        break_off(prepared, 0)
    assert len(str(refused.value).splitlines()) == 1


def test_a_training_that_goes_on_with_another_package_says_so(prepared, monkeypatch):
    notes, versions = [], training.package_versions()
    callbacks = Callbacks(note=notes.append)
    monkeypatch.setattr(training, "package_versions", lambda: {**versions, "torch": "0"})
    run_training(CONFIG, prepared, resume=True, device="cpu", callbacks=callbacks)
    (said,) = [note for note in notes if "continued with" in note]
    assert f"torch {versions['torch']}, continued with 0" in said


def test_a_training_without_a_gradient_step_says_so(tmp_path):
    notes = []
    short = replace(CONFIG, random_steps=50, exploration=PhaseConfig(5), task_phase=PhaseConfig(0))
    run_training(short, tmp_path, device="cpu", callbacks=Callbacks(note=notes.append))
    assert "nothing is learned" in notes[0]
