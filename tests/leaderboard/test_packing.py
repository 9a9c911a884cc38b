"""From checkpoints to a submission that is whole or not there."""

import os
import signal
from pathlib import Path

import pytest
import torch

from minitouch_bench.agents.config import make_config
from minitouch_bench.commands.submit import submit
from minitouch_bench.errors import PolicyError, RunDirectoryError, UsageError
from minitouch_bench.files import write_file
from minitouch_bench.json_io import write_toml
from minitouch_bench.leaderboard import packing
from minitouch_bench.leaderboard.packing import PACKING
from minitouch_bench.leaderboard.submission import check_submission, read_submission
from minitouch_bench.protocol.minitouch import TASK_NAMES
from tests.leaderboard.playing import write_policy

ABOUT = {"name": "hac", "training_steps": 1000, "learner": "SAC"}


@pytest.fixture(autouse=True)
def working(tmp_path, monkeypatch):
    """A working directory with two policies."""
    monkeypatch.chdir(tmp_path)
    for number in range(2):
        write_policy(Path(f"policy-{number}.safetensors"), number)
    return tmp_path


@pytest.fixture
def no_trial(monkeypatch):
    """Skip the trial episodes, which test_the_trial tries."""
    monkeypatch.setattr(packing, "_try_policies", lambda *_: None)


def told(name="hac"):
    place = Path("submissions", name)
    assert [*check_submission(place)] == []
    return read_submission(place)


def state(directory):
    files = [path for path in directory.rglob("*") if path.is_file()]
    return {path.relative_to(directory): path.read_bytes() for path in files}


class Still(torch.nn.Module):
    def forward(self, image, touch):
        return touch[:, :5] * 0


def test_code_outside_the_sandbox_needs_trust(capsys):
    example = torch.zeros(1, 1, 84, 84, dtype=torch.uint8), torch.zeros(1, 11)
    torch.export.save(torch.export.export(Still(), example), "mine.pt2")
    of_mine = {**ABOUT, "policies": ["mine.pt2"], "workers": "1", "isolation": "process"}
    with pytest.raises(PolicyError, match="--trust"):
        submit(**of_mine)
    submit(**of_mine, trust=True)
    assert capsys.readouterr().out == "submissions/hac\n"


def test_the_trial_plays_each_policy_and_the_submission_is_whole(capsys):
    submit(["policy-0.safetensors"], exploration=["policy-1.safetensors"], workers="1", **ABOUT)
    assert capsys.readouterr().out == "submissions/hac\n"
    found = told()
    assert [file.role for file in found.trainings[0].checkpoints] == ["final", "exploration"]
    assert sorted(os.listdir("submissions/hac")) == ["checkpoints", "submission.toml"]
    packed = Path("submissions/hac/checkpoints/seed-0/final/policy-0.safetensors")
    assert packed.read_bytes() == Path("policy-0.safetensors").read_bytes()
    with pytest.raises(RunDirectoryError, match="--name"):
        submit(["policy-0.safetensors"], **ABOUT)


def test_a_policy_that_cannot_be_loaded_is_refused_and_nothing_is_written():
    Path("bad.safetensors").write_bytes(b"\x80\x02" * 50)
    with pytest.raises(PolicyError):
        submit(["bad.safetensors"], **ABOUT)
    assert not Path("submissions/hac").exists()
    assert not Path("submissions", PACKING).exists()


def test_the_trial_finds_a_task_that_one_of_the_suites_needs():
    for task in ("playing", "opening", "pick-up"):
        write_policy(Path("policies", f"{task}.safetensors"), 0)
    with pytest.raises(PolicyError, match="pushing"):
        submit(["policies"], suites="dark,table4", workers="1", **ABOUT)


@pytest.mark.usefixtures("no_trial")
def test_each_policy_is_a_training():
    policies = ["policy-0.safetensors", "policy-1.safetensors"]
    submit(policies, training_seeds="7,5", **ABOUT)
    assert [training.seed for training in told().trainings] == [7, 5]
    for number, task in enumerate(TASK_NAMES):
        write_policy(Path("policies", f"{task}.safetensors"), number)
    submit(["policies"], **{**ABOUT, "name": "directory"})
    assert {file.task for file in told("directory").trainings[0].checkpoints} == {*TASK_NAMES}


def make_training(task, seed, without=()):
    """Write the directory of a finished training."""
    place = Path("reports/training", f"{task}-hac-{seed}")
    settings = {"seed": seed, "task_phase": {"without": [*without]}}
    config = make_config(task, settings=settings)
    write_file(place / "config.toml", write_toml(config))
    write_policy(place / "final.safetensors", 10 * seed + TASK_NAMES.index(task))
    content = (place / "final.safetensors").read_bytes()
    if task == "playing":  # whose final policy is the exploration policy
        write_file(place / "exploration.safetensors", content)
    else:
        write_policy(place / "exploration.safetensors", 100 * seed + TASK_NAMES.index(task))
    return str(place)


@pytest.mark.usefixtures("no_trial")
def test_training_directories_are_grouped_by_their_seed():
    places = [make_training(task, seed) for task in TASK_NAMES for seed in (21, 20)]
    submit(places, name="hac")
    found = told()
    assert [training.seed for training in found.trainings] == [20, 21]
    assert (found.method, found.training_steps) == ("hac", 110_000)
    assert "keypoints" in found.learner
    assert found.modalities == ("vision", "touch")
    files = [(file.role, file.task) for file in found.trainings[0].checkpoints]
    assert len(files) == 7
    assert ("exploration", "playing") not in files
    submit([make_training("pushing", 1, without=("forces", "vision"))], name="blind")
    assert told("blind").modalities == ("proprioception",)
    assert "keypoints" not in told("blind").learner
    assert [file.role for file in told("blind").trainings[0].checkpoints] == ["final"]


@pytest.mark.usefixtures("no_trial")
def test_unlike_trainings_are_not_one_method():
    one, other = make_training("pushing", 1), make_training("pushing", 2, without=("forces",))
    with pytest.raises(UsageError, match="alike"):
        submit([one, other], name="mixed")
    with pytest.raises(UsageError, match="one seed"):
        submit([one, one], name="twice")


POLICY = ["policy-0.safetensors"]


@pytest.mark.parametrize(
    ("policies", "options", "word"),
    [
        (POLICY, {"name": "../up"}, "name"),
        (POLICY, {"method": "<script>"}, "method"),
        (POLICY, {"modalities": "smell"}, "modalities"),
        (POLICY, {"suites": "smoke"}, "suites"),
        (POLICY, {"training_steps": None}, "--training-steps"),
        (POLICY, {"training_seeds": "1,2"}, "training seeds"),
        (POLICY, {"exploration": ["random"]}, "not a checkpoint"),
        (POLICY * 2, {"exploration": ["policy-1.safetensors"]}, "exploration policies"),
        (["policy-0.safetensors", "policy-1.safetensors"], {"training_seeds": "1,1"}, "different"),
        (["policy-0.safetensors", "policy-1.safetensors"], {"training_seeds": "1,1,2"}, "2 diff"),
        (["random"], {"name": "zero"}, "has a row already"),
        (["http://localhost:1"], {}, "not a checkpoint"),
    ],
)
def test_mistakes_are_told_and_nothing_is_written(policies, options, word):
    with pytest.raises(UsageError, match=word):
        submit(policies, **{**ABOUT, **options})
    assert not Path("submissions").exists() or os.listdir("submissions") == []


@pytest.mark.usefixtures("no_trial")
def test_a_folder_or_a_link_that_is_there_is_never_replaced(working):
    Path("submissions").mkdir()
    Path("submissions/hac").symlink_to(working / "elsewhere")
    with pytest.raises(RunDirectoryError, match="is there"):
        submit(POLICY, **ABOUT)
    Path("submissions/hac").unlink()
    with pytest.raises(RunDirectoryError, match="File name too long"):
        submit(POLICY, directory=Path("x" * 300), **ABOUT)
    Path("submissions", PACKING).symlink_to(working)
    with pytest.raises(RunDirectoryError, match="cleared"):
        submit(POLICY, **ABOUT)
    assert Path(POLICY[0]).exists()


KILLING = ("rename", "replace", "mkdir", "rmdir", "unlink")


def submit_and_be_killed_at(number):
    """Submit in a child that kills itself before its n-th change of a directory; True if it did."""
    child = os.fork()
    if child == 0:
        try:
            calls = iter(range(number))
            for name in KILLING:
                setattr(os, name, _counted(getattr(os, name), calls))
            submit(POLICY, **ABOUT)
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status)


def _counted(call, calls):
    def counted(*given, **named):
        if next(calls, None) is None:
            os.kill(os.getpid(), signal.SIGKILL)
        return call(*given, **named)

    return counted


@pytest.mark.usefixtures("no_trial")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_kill_at_any_moment_leaves_a_whole_submission_or_none(working):
    submit(POLICY, **ABOUT)
    place = working / "submissions"
    whole, number, there = state(place), 1, set()
    (place / "hac").rename(working / "kept-0")
    while submit_and_be_killed_at(number):
        there.add((place / "hac").exists())
        if (place / "hac").exists():
            found = {path: bits for path, bits in state(place).items() if path.parts[0] == "hac"}
            assert found == whole
            (place / "hac").rename(working / f"kept-{number}")
        number += 1
    assert there == {False, True}
    assert number > 5
    assert state(place) == whole
    assert os.listdir(place) == ["hac"]
