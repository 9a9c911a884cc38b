"""From a policy to a packed submission, as a user types it."""

import os
import signal
import time
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.workflows.submit import submit
from tests.cli.command import finish, run, start
from tests.leaderboard.synthetic import CHECKPOINT, official_run, write_official

HOPELESS = ("submit", "hopeless:Policy", "--trust", "--name", "hopeless", "--workers", 2)
"""A policy that fails at every first step: the official episodes take seconds."""

PACK = {"name": "hac", "runs": (Path("reports/hac-table4"),), "fresh": True}
FACTS = {"run.json", "actions.npz"}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished official run, and the checkpoint that it says it evaluated."""
    root = tmp_path_factory.mktemp("finished")
    write_official(official_run(), root / "reports" / "hac-table4")
    (root / "hac.safetensors").write_bytes(CHECKPOINT)
    return root


def pack(directory, *options):
    reports = directory / "reports" / "hac-table4"
    return run("submit", "--run", reports, "--name", "hac", *options, directory=directory)


def test_a_finished_run_is_packed_with_its_checkpoint(finished):
    done = pack(finished, "--training-steps", 1000, "--method", "HaC", "--authors", "A. B, C. D")
    assert done.code == 0, done.err
    assert done.out == "submissions/hac\n"
    assert "leaderboard validate submissions/hac" in done.err
    place = finished / "submissions" / "hac"
    assert set(os.listdir(place / "seed-0" / "table4")) == FACTS
    told = tomllib.loads((place / "submission.toml").read_text())
    assert (told["method"], told["training_steps"]) == ("HaC", 1000)
    assert told["authors"] == ["A. B", "C. D"]
    (file,) = told["seeds"][0]["checkpoints"]
    assert (place / file["path"]).read_bytes() == CHECKPOINT


def test_another_training_seed_is_added_and_what_was_told_is_kept(finished):
    again = pack(finished, "--training-seed", 0, "--method", "HaC")
    assert again.code == 6
    assert "--fresh" in again.err
    run_again = official_run(seed=5)
    write_official(run_again, finished / "reports" / "five")
    done = run(
        "submit", "--run", "reports/five", "--name", "hac", "--training-seed", 5,
        "--no-include-checkpoint", "--notes", "two seeds", directory=finished,
    )  # fmt: skip
    assert done.code == 0, done.err
    told = tomllib.loads((finished / "submissions/hac/submission.toml").read_text())
    assert (told["method"], told["notes"]) == ("HaC", "two seeds")
    assert [seed["seed"] for seed in told["seeds"]] == [0, 5]
    assert [seed["checkpoints"][0]["path"] != "" for seed in told["seeds"]] == [True, False]


def test_a_checkpoint_that_is_gone_is_named_by_its_digest(finished, tmp_path):
    write_official(official_run(), tmp_path / "reports" / "hac-table4")
    done = pack(tmp_path)
    assert done.code == 0, done.err
    assert "only its SHA-256 is kept" in done.err
    told = tomllib.loads((tmp_path / "submissions/hac/submission.toml").read_text())
    assert told["seeds"][0]["checkpoints"][0]["path"] == ""


@pytest.fixture
def packed(tmp_path, monkeypatch):
    """A submission, packed of a run and its checkpoint, in the working directory."""
    monkeypatch.chdir(tmp_path)
    write_official(official_run(), Path("reports/hac-table4"))
    Path("hac.safetensors").write_bytes(CHECKPOINT)
    assert submit(**PACK).problems == ()
    return tmp_path / "submissions" / "hac"


def state(directory):
    files = [path for path in directory.rglob("*") if path.is_file()]
    return {path.relative_to(directory): path.read_bytes() for path in files}


def test_no_source_and_submission_lie_one_in_the_other(packed):
    before = state(packed)
    inside = packed / "seed-0" / "table4"
    checkpoint = packed / "checkpoints" / "seed-0" / "final" / "hac.safetensors"
    for other in (
        {"runs": (inside,)},
        {"runs": (), "policy": str(checkpoint)},
        {"runs": (), "policy": str(packed.parents[1])},
    ):
        with pytest.raises(UsageError, match="one in the other"):
            submit(**{**PACK, **other})
    assert state(packed) == before


def test_the_only_copy_of_a_checkpoint_is_never_removed(packed):
    before = state(packed)
    Path("hac.safetensors").unlink()
    for include in (True, False):
        with pytest.raises(RunDirectoryError, match="no other copy"):
            submit(**PACK, include_checkpoint=include)
    assert state(packed) == before
    Path("hac.safetensors").write_bytes(CHECKPOINT)
    assert submit(**PACK, include_checkpoint=False).problems == ()
    assert not list(packed.rglob("*.safetensors"))


@pytest.mark.parametrize("include", [True, False])
def test_a_checkpoint_that_a_submission_alone_holds_stays(tmp_path, monkeypatch, include):
    """The run was made with the submission's own file."""
    monkeypatch.chdir(tmp_path)
    checkpoint = Path("submissions/hac/checkpoints/seed-0/final/only.safetensors")
    checkpoint.parent.mkdir(parents=True)
    checkpoint.write_bytes(CHECKPOINT)
    done = official_run()
    policy = replace(done.header.policy, source=str(checkpoint))
    write_official(replace(done, header=replace(done.header, policy=policy)), PACK["runs"][0])
    if include:
        assert submit(**PACK).problems == ()
    else:
        with pytest.raises(RunDirectoryError, match="no other copy"):
            submit(**PACK, include_checkpoint=False)
    assert checkpoint.read_bytes() == CHECKPOINT


def test_a_file_of_the_user_in_a_submission_s_run_is_not_replaced(packed):
    (packed / "seed-0" / "table4" / "notes.txt").write_text("mine")
    with pytest.raises(RunDirectoryError, match=r"notes\.txt"):
        submit(**PACK)


def test_a_submission_that_would_be_refused_changes_nothing(packed):
    before = state(packed)
    Path("reports/hac-table4/actions.npz").write_bytes(b"damaged")
    assert submit(**PACK).problems
    assert state(packed) == before
    assert os.listdir("submissions") == ["hac"]


def test_one_training_is_not_two_seeds_and_the_first_stays_as_it_is(packed):
    before = state(packed)
    (problem,) = submit(**PACK, training_seed=1).problems
    assert "bit for bit those of seed-0/table4" in str(problem)
    assert state(packed) == before


def test_an_unofficial_run_is_refused(scripted, tmp_path):
    done = run("submit", "--run", scripted[1], "--name", "scripted", directory=tmp_path)
    done.refused(2, "not an official run", "2 of 100 episodes per task")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("zero", "--name", "../up"), ("is no name",)),
        (("zero", "--name", "zero", "--paper", "javascript:1"), ("paper", "is no link")),
        (("zero", "--name", "zero", "--method", "<script>"), ("method", "HTML")),
        (("zero", "--name", "zero", "--modalities", "smell"), ("smell",)),
        (("zero", "--name", "zero", "--suites", "smoke"), ("--suites",)),
        (("--name", "zero"), ("POLICY", "--run")),
        (("--run", "reports/zero"), ("--name",)),
        (("Mine.onnx",), ("name", "Mine")),
        (("random", "--name", "my-random"), ("built-in policy random is not 'my-random'",)),
        (("random", "--modalities", "vision"), ("random is one seed with the modalities []",)),
        (("zero", "--exploration", "scripted"), ("its exploration is the scripted policy's",)),
        (("hopeless:Policy", "--trust", "--name", "zero"), ("is a built-in policy's",)),
        (("zero", "--training-seed", 2**63), ("seed",)),
    ],
)
def test_mistakes_are_told_before_anything_is_run(tmp_path, options, words):
    run("submit", *options, directory=tmp_path).refused(2, *words)
    assert os.listdir(tmp_path) == []


@pytest.fixture
def nothing_is_played(monkeypatch):
    def play(*_):
        raise AssertionError("an episode would be played")

    monkeypatch.setattr("minitouch_bench.workflows.submitting.play", play)


@pytest.mark.usefixtures("nothing_is_played")
def test_a_checkpoint_s_name_is_checked_before_anything_is_run(tmp_path, monkeypatch):
    from minitouch_bench.policies.native import save_native
    from minitouch_bench.policies.networks import TouchActor

    monkeypatch.chdir(tmp_path)
    save_native(TouchActor(action_size=4), Path("my policy.safetensors"))
    with pytest.raises(UsageError, match="no plain file name"):
        submit("my policy.safetensors", name="mine")
    assert os.listdir(tmp_path) == ["my policy.safetensors"]


@pytest.mark.usefixtures("nothing_is_played")
def test_every_suite_s_directory_is_checked_before_the_first_is_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    place = Path("submissions/zero/seed-0")
    write_official(official_run("novel-shapes", kind="zero"), place / "novel-shapes")
    both = {"policy": "zero", "suites": ("table4", "novel-shapes")}
    with pytest.raises(RunDirectoryError, match="novel-shapes already contains a run"):
        submit(**both)
    (place / "novel-shapes" / "run.json").unlink()
    (place / "novel-shapes" / "unfinished").mkdir()
    with pytest.raises(RunDirectoryError, match="novel-shapes already contains a run"):
        submit(**both)
    assert os.listdir(place) == ["novel-shapes"]


@pytest.mark.slow
def test_three_commands_lead_from_a_policy_to_a_row(tmp_path):
    given_up = run(*HOPELESS, "--method", "Hopeless", directory=tmp_path)
    assert given_up.code == 5
    assert "the first 10 episodes are all policy faults" in given_up.err
    assert "--resume continues" in given_up.err
    done = run(*HOPELESS, "--method", "Hopeless", "--resume", directory=tmp_path)
    assert done.code == 0, done.err
    assert "400 faults" in done.err
    place = tmp_path / "submissions" / "hopeless" / "seed-0" / "table4"
    assert set(os.listdir(place)) == FACTS
    proved = run("leaderboard", "validate", "submissions/hopeless", "--replay", directory=tmp_path)
    assert (proved.code, proved.out) == (0, "hopeless: valid, replay-verified\n")
    built = run("leaderboard", "build", directory=tmp_path)
    assert built.code == 0, built.err
    page = (tmp_path / "reports" / "leaderboard" / "index.html").read_text()
    assert 'href="submission/hopeless.html"' in page
    assert "Not ranked: nobody has run them again yet" in page
    again = run(*HOPELESS, directory=tmp_path)
    again.refused(6, "already contains a run", "--training-seed")
    kept = run(*HOPELESS, "--resume", directory=tmp_path)
    assert kept.code == 0, kept.err
    other = run("submit", "strangers:Policy", *HOPELESS[2:], "--resume", directory=tmp_path)
    assert other.code == 6
    assert "holds another run" in other.err


@pytest.mark.slow
def test_a_submission_that_was_broken_off_is_resumed(tmp_path):
    assert run(*HOPELESS, directory=tmp_path).code == 5
    process = start(*HOPELESS, "--resume", directory=tmp_path)
    place = tmp_path / "submissions" / "hopeless" / "seed-0" / "table4"
    deadline = time.monotonic() + 300
    while len(list((place / "unfinished").glob("*.unit"))) < 20:
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    broken = finish(process)
    assert broken.code == 130
    assert "--resume continues" in broken.err
    invalid = run("leaderboard", "validate", "submissions/hopeless", directory=tmp_path)
    assert invalid.code == 1
    assert "this is no submission" in invalid.out
    done = run(*HOPELESS, "--resume", directory=tmp_path)
    assert done.code == 0, done.err
    assert set(os.listdir(place)) == FACTS
