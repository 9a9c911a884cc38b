"""What a submission may hold, and every attack on it that is known, each refused by name."""

import os
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

from minitouch_bench.leaderboard.validation import validate
from minitouch_bench.runs.run import parse_run, run_digest
from tests.altered import edit_actions, edit_document
from tests.archives import zipped
from tests.leaderboard.synthetic import make_submission, official_run, write_official

RUN = "seed-0/table4"


def refused(directory: Path, *words: str) -> list[str]:
    """Check that the submission is refused and that one line holds all of these words."""
    lines = [str(problem) for problem in validate(directory).problems]
    assert any(all(word in line for word in words) for line in lines), lines
    assert not any("\n" in line or len(line) > 1300 for line in lines)
    return lines


def edit_run(directory: Path, change, run=RUN, *, seal=False) -> None:
    """Change the document of a run; with ``seal`` its digest is made to agree again."""
    file = directory / run / "run.json"
    edit_document(file, change)
    if seal:
        saved = parse_run(file.read_bytes(), "x")
        digest = run_digest(saved.header, saved.rows, saved.exploration_rows)
        edit_document(file, lambda document: document.update(digest=digest))


def edit_toml(directory: Path, old: str, new: str) -> None:
    file = directory / "submission.toml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


# What is sound


def test_a_sound_submission_has_no_fault(sound):
    found = validate(sound)
    assert found.problems == ()
    assert found.passed
    assert set(found.runs) == {RUN}


def test_several_seeds_suites_and_policy_faults_are_sound(tmp_path):
    both = ("table4", "novel-shapes")
    directory = make_submission(tmp_path, "multi", seeds=(0, 7), suites=both, faults=3)
    found = validate(directory)
    assert found.problems == ()
    assert set(found.runs) == {f"seed-{seed}/{suite}" for seed in (0, 7) for suite in both}


@pytest.mark.parametrize("kind", ["random", "zero", "scripted", "remote"])
def test_policies_without_a_file_are_sound(tmp_path, kind):
    name = "host" if kind == "remote" else kind
    assert validate(make_submission(tmp_path, name, kind=kind)).problems == ()


def test_checkpoints_need_not_be_included(tmp_path):
    directory = make_submission(tmp_path, include=False)
    assert not (directory / "checkpoints").exists()
    assert validate(directory).problems == ()


def test_every_fault_is_told_at_once(submission):
    edit_toml(submission, 'method = "HaC, retrained"', 'method = "<b>bold</b>"')
    edit_toml(submission, 'paper = "https://', 'paper = "http://')
    edit_run(submission, lambda run: run["episodes"].pop())
    (submission / "extra.txt").write_text("hello")
    found = "\n".join(refused(submission, "submission.toml", "method"))
    for words in ("paper", "399 recorded of 400", "extra.txt"):
        assert words in found


# Runs


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d["episodes"][0].update(clipped_actions=1), (RUN, "clipped_actions")),
        (lambda d: d["header"].update(protocol="minitouch-v2"), ("header.protocol: ",)),
        (lambda d: d["header"].update(isolation="none"), ("isolation none",)),
        (lambda d: d["header"]["policy"].update(digest="0" * 64), ("is not the checkpoints",)),
    ],
)
def test_no_run_can_be_edited(submission, change, words):
    edit_run(submission, change)
    refused(submission, *words)


def test_failures_turned_into_successes(submission):
    def change(run):
        for episode in run["episodes"]:
            if episode["outcome"] == "left_workspace":
                episode.update({"outcome": "success", "episode_return": 25.0})

    edit_run(submission, change)
    refused(submission, RUN, "digest: it is not that of the episodes")
    edit_run(submission, lambda run: None, seal=True)
    refused(submission, RUN, "success", "recorded")


def test_another_protocol_s_run(submission):
    edit_run(submission, lambda run: run["header"]["task_digests"].update(pushing="0" * 64))
    assert validate(submission).is_other_protocol
    refused(submission, "the rules of pushing are not", "000000000000", "evaluate again")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a: a.pop("pushing/17"), ("pushing/17", "missing")),
        (lambda a: a.update({"pushing/3": a["pushing/3"][:-1]}), ("pushing/3", "steps")),
        (lambda a: a["opening/0"].__setitem__(0, np.nan), ("opening/0", "beyond -1 to 1")),
        (lambda a: a.update({"pushing/100": a["pushing/1"]}), ("pushing/100",)),
    ],
)
def test_no_actions_can_be_edited(submission, change, words):
    edit_actions(submission / RUN, change)
    refused(submission, "actions.npz", *words)


# Policies


def test_a_server_that_hides_what_it_is(tmp_path):
    directory = make_submission(tmp_path, "host", kind="remote")
    edit_run(directory, lambda run: run["header"]["policy"].update(notes=[]))
    refused(directory, "remote policy lacks its label")


def with_another_run(tmp_path, seeds, run):
    """Make a submission of several training seeds, with this run as that of the last one."""
    directory = make_submission(tmp_path, seeds=seeds, include=False)
    shutil.rmtree(directory / f"seed-{seeds[-1]}")
    write_official(run, directory / f"seed-{seeds[-1]}/table4")
    return directory


def test_an_exploration_policy_of_one_training_seed_alone(tmp_path):
    run = official_run(seed=1, exploration=True)
    directory = with_another_run(tmp_path, (0, 2, 1), run)
    refused(directory, "2 of 3 training seeds have no exploration policy: 0, 2")


@pytest.mark.parametrize("exploration", [False, True])
def test_a_training_seed_submitted_twice(tmp_path, exploration):
    """With its exploration the final episodes are the same bits, and the run's digest is not."""
    directory = with_another_run(tmp_path, (0, 1), official_run(seed=0, exploration=exploration))
    refused(directory, "seed-1/table4", "400 of its 400 episodes are bit for bit those of seed-0")


def test_an_exploration_by_the_scripted_policy(submission):
    scripted = {"kind": "scripted", "digest": "", "notes": ["reads the simulator's state"]}
    edit_run(submission, lambda run: run["header"]["exploration"].update(scripted))
    refused(submission, "its exploration is the scripted policy's")


def test_a_trained_policy_cannot_take_a_calibration_s_name(submission):
    moved = submission.rename(submission.parent / "random")
    edit_toml(moved, 'name = "hac"', 'name = "random"')
    refused(moved, "'random' is a built-in policy's")


# Text


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"A. Researcher"', '"<script>alert(1)</script>"', "plain text"),
        ("version = 1", "version = 0x" + 4000 * "f", "version is not 1"),
        ("training_steps = 2000000", "training_steps = nan", "training_steps"),
        ('"vision",\n    "touch"', '"state"', "only scripted"),
        ('name = "hac"', 'nme = "hac"', "'name' is missing"),
        ("[[seeds]]", "[[seeds", "is not TOML"),
    ],
)
def test_other_mistakes_in_the_file(submission, old, new, words):
    edit_toml(submission, old, new)
    refused(submission, "submission.toml", words)


def test_a_mistake_in_the_seeds_is_the_only_problem(submission):
    edit_toml(submission, 'sha256 = "', 'sha256 = "X')
    assert len(refused(submission, "sha256")) == 1


# Paths and files


@pytest.mark.parametrize("path", ["../../secret", "/etc/passwd"])
@pytest.mark.parametrize(
    "place", ['table4 = "seed-0/table4"', 'path = "checkpoints/seed-0/final/hac.safetensors"']
)
def test_paths_that_lead_elsewhere(submission, path, place):
    edit_toml(submission, place, f'{place.partition(" = ")[0]} = "{path}"')
    refused(submission, path, "outside its place")


@pytest.mark.parametrize("place", [f"{RUN}/run.json", RUN, "submission.toml", "checkpoints"])
def test_symbolic_links(submission, tmp_path, place):
    target = tmp_path / "elsewhere"
    (submission / place).rename(target)
    (submission / place).symlink_to(target)
    assert len(refused(submission, place, "symbolic link")) == 1


@pytest.mark.parametrize("name", ["run.json", "actions.npz"])
def test_a_missing_file_is_told_once(submission, name):
    (submission / RUN / name).unlink()
    assert len(refused(submission, f"{RUN}/{name}", "it is missing")) == 1


def test_a_named_pipe_is_never_opened(submission):
    os.mkfifo(submission / RUN / "pipe")
    refused(submission, f"{RUN}/pipe", "no plain file")


@pytest.mark.parametrize(
    "place", [f"{RUN}/conftest.py", "proof.json", "checkpoints/seed-0/final/other.safetensors"]
)
def test_unknown_files(submission, place):
    (submission / place).write_text("raise SystemExit")
    refused(submission, place, "no such file")


def test_files_that_are_too_large(submission):
    with (submission / RUN / "actions.npz").open("r+b") as file:
        file.truncate(100 * 2**20)
    refused(submission, f"{RUN}/actions.npz", "the limit is")
    assert not validate(submission).runs  # it is not read


def test_a_zip_bomb_as_a_checkpoint(submission):
    bomb = zipped({"data.pkl": bytes(300_000_000)}, zipfile.ZIP_DEFLATED)
    for role in ("final", "exploration"):
        place = submission / f"checkpoints/seed-0/{role}/hac.safetensors"
        place.rename(place.with_suffix(".pt"))
        place.with_suffix(".pt").write_bytes(bomb)
    file = submission / "submission.toml"
    file.write_text(file.read_text().replace("hac.safetensors", "hac.pt"))
    refused(submission, "hac.pt", "declares 300000000: it is not unpacked")
    refused(submission, "hac.pt", "SHA-256 is not that of submission.toml")


def test_a_checkpoint_that_was_replaced_after_its_proof(submission):
    """A leaderboard trusts what was proved of the runs, and looks at the checkpoints again."""
    (submission / "checkpoints/seed-0/final/hac.safetensors").write_bytes(b"another policy")
    (problem,) = validate(submission, trust_proofs=True).problems
    assert "SHA-256 is not that of submission.toml" in str(problem)


def test_a_key_that_is_there_twice(submission):
    file = submission / RUN / "run.json"
    text = file.read_text()
    file.write_text(text.replace('"official": true,', '"official": false,\n  "official": true,', 1))
    refused(submission, f"{RUN}, run.json", "there twice")


def test_what_is_no_submission(tmp_path):
    refused(tmp_path / "none", "it is not a directory")
    refused(tmp_path, "this is not a submission")
