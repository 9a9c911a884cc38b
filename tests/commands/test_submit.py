"""From finished runs to a packed submission, as a user types it."""

import os
import signal
import tomllib
from pathlib import Path

import pytest
import typer

from minitouch_bench.commands.submit import submit
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.json_io import write_toml
from minitouch_bench.leaderboard.packing import PACKING
from minitouch_bench.leaderboard.validation import validate
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.protocol.minitouch import TASK_NAMES
from tests.commands.command import run
from tests.leaderboard.synthetic import CHECKPOINT, official_run, write_official

RUN = Path("reports/hac-table4")
ABOUT = {"name": "hac", "training_steps": 1000}
FACTS = {"run.json", "actions.npz"}
HOPELESS = ("misbehaved:Untaught", "--trust", "--workers", 2)
"""A policy that fails at every first step: the official episodes take seconds."""


def write_run(place, policy="hac.safetensors", **about):
    """Write a finished official run, whose policy has the file's bytes if it is there."""
    write_official(official_run(source=policy, **about), Path(place))


@pytest.fixture
def evaluated(tmp_path, monkeypatch):
    """A working directory with a finished run and the checkpoint that was evaluated."""
    monkeypatch.chdir(tmp_path)
    write_run(RUN)
    Path("hac.safetensors").write_bytes(CHECKPOINT)
    return tmp_path


def told(name="hac"):
    return tomllib.loads(Path("submissions", name, "submission.toml").read_text())


def state(directory):
    files = [path for path in directory.rglob("*") if path.is_file()]
    return {path.relative_to(directory): path.read_bytes() for path in files}


def test_a_finished_run_is_packed_with_its_checkpoint(evaluated):
    about = ("--name", "hac", "--training-steps", 1000, "--authors", "A. B, C. D")
    done = run("submit", RUN, *about, "--method", "HaC", directory=evaluated)
    assert done.code == 0, done.err
    assert done.out == "submissions/hac\n"
    assert "leaderboard validate submissions/hac" in done.err
    place = evaluated / "submissions" / "hac"
    assert set(os.listdir(place / "seed-0" / "table4")) == FACTS
    assert (told()["method"], told()["training_steps"]) == ("HaC", 1000)
    assert told()["authors"] == ["A. B", "C. D"]
    (file,) = told()["seeds"][0]["checkpoints"]
    assert (place / file["path"]).read_bytes() == CHECKPOINT
    assert os.listdir("submissions") == ["hac"]
    again = run("submit", RUN, *about, directory=evaluated)
    again.refused(6, "submissions/hac", "--name")


def test_runs_of_several_trainings_and_suites_are_packed_together(evaluated):
    """Each policy is one training, whatever the order of its suites."""
    write_run("reports/zero", "zero", seed=3, kind="factory")
    write_run("reports/novel", suite="novel-shapes")
    runs = [Path("reports/novel"), RUN, Path("reports/zero")]
    submit(runs, training_seeds="7,5", **ABOUT)
    seeds = {seed["seed"]: seed for seed in told()["seeds"]}
    assert [*seeds] == [7, 5]
    assert [*seeds[7]["runs"]] == ["table4", "novel-shapes"]
    assert [*seeds[5]["runs"]] == ["table4"]
    assert not validate(Path("submissions/hac")).problems


def test_the_exploration_checkpoint_is_packed_too(evaluated):
    write_run("reports/both", exploration=True)
    submit([Path("reports/both")], **ABOUT)
    files = told()["seeds"][0]["checkpoints"]
    assert [file["role"] for file in files] == ["final", "exploration"]
    packed = {Path("submissions/hac", file["path"]).read_bytes() for file in files}
    assert packed == {CHECKPOINT}


@pytest.fixture
def per_task(evaluated):
    """A finished run of a directory with a checkpoint for each task."""
    Path("policies").mkdir()
    for task in TASK_NAMES:
        Path("policies", f"{task}.safetensors").write_bytes(CHECKPOINT + task.encode())
    policy = vars(parse_source("policies").identity())
    write_official(official_run(**policy), Path("reports/per-task"))
    return Path("reports/per-task")


def test_a_directory_is_packed_with_the_checkpoint_of_each_task(per_task):
    submit([per_task], **ABOUT)
    place = Path("submissions/hac")
    found = validate(place)
    assert not found.problems
    packed = {
        file.task: (place / file.path).read_bytes()
        for file in found.submission.seeds[0].checkpoints
    }
    assert packed == {task: CHECKPOINT + task.encode() for task in TASK_NAMES}


@pytest.mark.parametrize("change", ["swap", "remove"])
def test_a_directory_that_was_changed_since_is_refused(per_task, change):
    one, other = Path("policies/opening.safetensors"), Path("policies/pushing.safetensors")
    content = other.read_bytes()
    other.unlink()
    if change == "swap":
        other.write_bytes(one.read_bytes())
        one.write_bytes(content)
    with pytest.raises(UsageError, match="has changed"):
        submit([per_task], **ABOUT)
    assert not Path("submissions").exists()


def test_checkpoints_that_are_not_those_of_the_evaluated_directory_are_a_problem(per_task):
    submit([per_task], **ABOUT)
    file = Path("submissions/hac/submission.toml")
    document = tomllib.loads(file.read_text())
    one, other, *_ = document["seeds"][0]["checkpoints"]
    one["sha256"], other["sha256"] = other["sha256"], one["sha256"]
    paths = [file.parent / each["path"] for each in (one, other)]
    contents = [path.read_bytes() for path in paths]
    for path, content in zip(paths, reversed(contents), strict=True):
        path.write_bytes(content)
    file.write_text(write_toml(document))
    (problem,) = validate(file.parent).problems
    assert "is not the checkpoints" in str(problem)


@pytest.mark.parametrize("include", [True, False])
def test_a_checkpoint_that_is_not_there_or_not_included_is_named_by_its_digest(
    evaluated, include, capsys
):
    if include:
        Path("hac.safetensors").unlink()
    submit([RUN], include_checkpoint=include, **ABOUT)
    assert ("only its SHA-256 is kept" in capsys.readouterr().err) == include
    (file,) = told()["seeds"][0]["checkpoints"]
    assert (file["file"], file["path"]) == ("hac.safetensors", "")
    assert not list(Path("submissions").rglob("*.safetensors"))


@pytest.mark.parametrize("file", ["run.json", "actions.npz"])
def test_a_damaged_run_leaves_nothing(evaluated, file):
    path = RUN / file
    path.write_bytes(path.read_bytes().replace(b"0", b"1", 1))
    done = run("submit", RUN, "--name", "hac", "--training-steps", 0, directory=evaluated)
    assert done.code == 1, done.err
    assert "seed-0/table4" in done.out
    assert not state(evaluated / "submissions")


def test_a_checkpoint_that_was_changed_since_is_refused(evaluated, capsys):
    Path("hac.safetensors").write_bytes(b"trained further")
    with pytest.raises(typer.Exit):
        submit([RUN], **ABOUT)
    assert "SHA-256" in capsys.readouterr().out
    assert os.listdir("submissions") == []


def test_an_unofficial_run_is_refused(scripted, tmp_path):
    about = ("--name", "scripted", "--training-steps", 0)
    done = run("submit", scripted[1], *about, directory=tmp_path)
    done.refused(2, "not an official run", "2 of 100 episodes per task")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("runs", "options", "words"),
    [
        ((RUN,), {"name": "../up"}, "a name of"),
        ((RUN,), {"paper": "javascript:1"}, "paper"),
        ((RUN,), {"method": "<script>"}, "method"),
        ((RUN,), {"modalities": "smell"}, "modalities"),
        ((RUN,), {"training_seeds": "1,2"}, "--training-seeds"),
        ((RUN, RUN), {}, "with one policy"),
        (("reports/novel",), {}, "table4"),
        (("reports/odd-name",), {}, "file name"),
    ],
)
def test_mistakes_are_told_and_nothing_is_written(evaluated, runs, options, words):
    if runs == ("reports/novel",):
        write_run("reports/novel", suite="novel-shapes")
    if runs == ("reports/odd-name",):
        write_run("reports/odd-name", "my policy.safetensors")
    with pytest.raises(UsageError, match=words):
        submit(list(map(Path, runs)), **{**ABOUT, **options})
    assert not Path("submissions").exists()


def test_a_folder_or_a_link_that_is_there_is_never_replaced(evaluated):
    Path("submissions").mkdir()
    Path("submissions/hac").symlink_to(evaluated / "elsewhere")
    with pytest.raises(RunDirectoryError, match="is there"):
        submit([RUN], **ABOUT)
    Path("submissions/hac").unlink()
    with pytest.raises(RunDirectoryError, match="File name too long"):
        submit([RUN], directory=Path("x" * 300), **ABOUT)
    Path("submissions", PACKING).symlink_to(evaluated / "reports")
    with pytest.raises(RunDirectoryError, match="cleared"):
        submit([RUN], **ABOUT)
    assert RUN.exists()


KILLING = ("rename", "replace", "mkdir", "rmdir", "unlink")


def submit_and_be_killed_at(number):
    """Submit in a child that kills itself before its n-th change of a directory; True if it did."""
    child = os.fork()
    if child == 0:
        try:
            calls = iter(range(number))
            for name in KILLING:
                setattr(os, name, _counted(getattr(os, name), calls))
            submit([RUN], **ABOUT)
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


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_kill_at_any_moment_leaves_a_whole_submission_or_none(evaluated):
    submit([RUN], **ABOUT)
    place = evaluated / "submissions"
    whole, number, there = state(place), 1, set()
    (place / "hac").rename(evaluated / "kept-0")
    while submit_and_be_killed_at(number):
        there.add((place / "hac").exists())
        if (place / "hac").exists():
            found = {path: bits for path, bits in state(place).items() if path.parts[0] == "hac"}
            assert found == whole
            (place / "hac").rename(evaluated / f"kept-{number}")
        number += 1
    assert there == {False, True}
    assert number > 10
    assert state(place) == whole
    assert os.listdir(place) == ["hac"]


@pytest.mark.slow
def test_three_commands_lead_from_a_policy_to_a_row(tmp_path):
    given_up = run("evaluate", *HOPELESS, directory=tmp_path)
    assert given_up.code == 5
    done = run("evaluate", *HOPELESS, "--resume", directory=tmp_path)
    assert done.code == 4, done.err
    (place,) = (tmp_path / "reports").iterdir()
    about = ("--name", "hopeless", "--training-steps", 0)
    packed = run("submit", place, *about, directory=tmp_path)
    assert packed.code == 0, packed.err
    proved = run("leaderboard", "validate", "submissions/hopeless", "--prove", directory=tmp_path)
    assert (proved.code, proved.out) == (0, "hopeless: valid, replayed\n")
    built = run("leaderboard", "build", directory=tmp_path)
    assert built.code == 0, built.err
    page = (tmp_path / "reports" / "leaderboard" / "index.html").read_text()
    assert 'href="submission/hopeless.html"' in page
