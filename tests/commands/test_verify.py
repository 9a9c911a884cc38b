import json
import socket
from dataclasses import replace

import numpy as np
import pytest

import minitouch_bench as mt
from minitouch_bench.runs.run import make_header, read_run, run_json
from tests.altered import ROOT, edit_document
from tests.commands.command import run, succeed
from tests.commands.conftest import ONE
from tests.evaluation.misbehaved import Still
from tests.leaderboard.playing import write_policy


def test_a_true_run_is_verified_and_run_again(scripted):
    directory = scripted[1]
    done = succeed("verify", directory, "--rerun", 2, directory=directory.parent)
    assert "4 episodes replayed" in done.out
    assert "2 episodes run again with the checkpoint" in done.out
    assert "is verified" in done.out


def test_an_edited_run_is_named_with_exit_1(copy):
    edit_document(copy / "run.json", lambda d: d["episodes"][0].update(outcome="step_limit"))
    done = run("verify", copy, "--rerun", 2, "--json", directory=copy.parent)
    result = json.loads(done.out)
    assert (done.code, result["passed"], result["reran"]) == (1, False, 0)
    assert result["problems"][0]["place"] == "digest"
    plain = run("verify", copy, directory=copy.parent)
    assert plain.code == 1
    assert "digest: " in plain.out
    assert "is not verified" in plain.out


def test_a_run_is_verified_without_its_checkpoint_and_run_again_with_it_alone(tmp_path):
    policy = write_policy(tmp_path / "policy.safetensors")
    both = ("evaluate", policy, "--exploration", policy)
    succeed(*both, *ONE, "--output", "run", directory=tmp_path)
    with np.load(tmp_path / "run" / "actions.npz") as actions:  # the one samples, the other not
        first, sampled = actions["pushing/0"], actions["exploration/pushing/0"]
    assert not np.array_equal(first[0], sampled[0])
    moved = policy.rename(tmp_path / "moved.safetensors")
    succeed("verify", "run", directory=tmp_path)
    for unused in (("--policy", moved), ("--isolation", "process")):
        run("verify", "run", *unused, directory=tmp_path).refused(2, "need --rerun N")
    run("verify", "run", "--rerun", 1, directory=tmp_path).refused(5, "is gone", "--policy")
    here = ("--policy", moved, "--exploration", moved)
    again = succeed("verify", "run", "--rerun", 1, *here, directory=tmp_path)
    assert "2 episodes run again with the checkpoint" in again.out
    write_policy(moved, seed=1)
    other = run("verify", "run", "--rerun", 1, *here, directory=tmp_path)
    other.refused(2, "is not the policy of this run")


def of_policy(directory, **policy):
    """Say that a run's policy is another one."""
    run = read_run(directory)
    header = run.header
    header = make_header(header.plan, replace(header.policy, **policy), None, header.isolation)
    (directory / "run.json").write_bytes(run_json(replace(run, header=header)))


def test_a_server_or_code_that_a_run_names_is_used_only_if_the_user_names_it(copy):
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.0)
        address = f"http://127.0.0.1:{server.getsockname()[1]}"
        of_policy(copy, kind="remote", source=address, notes=("remote",))
        unnamed = run("verify", copy, "--rerun", 1, directory=copy.parent)
        unnamed.refused(5, address, "only if you name it", "--policy")
        with pytest.raises(BlockingIOError):
            server.accept()
    for kind in ("factory", "native"):
        of_policy(copy, kind=kind, source="misbehaved:Still", digest="", notes=())
        unnamed = run("verify", copy, "--rerun", 1, "--trust", directory=copy.parent)
        unnamed.refused(5, "misbehaved:Still", "only if you name it", "--policy")


def test_a_run_of_a_submission_is_run_again_with_its_checkpoint(tmp_path):
    (tmp_path / "submissions").symlink_to(ROOT / "submissions")
    succeed("evaluate", "submissions/hac/seed-31", *ONE, directory=tmp_path)
    (place,) = (tmp_path / "reports").iterdir()
    assert place.name.startswith("hac-seed-31-")
    done = succeed("verify", place, "--rerun", 1, directory=tmp_path)
    assert "run again with the checkpoint" in done.out


def test_what_cannot_be_run_again_is_said_and_no_option_is_ignored(scripted, tmp_path):
    short = {"suite": "smoke", "tasks": "opening", "episodes": 1, "workers": 1}
    mt.evaluate(Still(), **short, output=tmp_path / "run")
    for more in ((), ("--policy", "zero")):
        in_memory = run("verify", "run", "--rerun", 1, *more, directory=tmp_path)
        in_memory.refused(5, "memory", "from a file")
        assert "--policy" not in in_memory.err
    unused = run("verify", scripted[1], "--rerun", 1, "--exploration", "zero", directory=tmp_path)
    unused.refused(2, "--exploration", "leave it out")


def test_what_is_no_run_or_damaged_ends_with_6(copy, tmp_path):
    for place, word in ((tmp_path, "no run.json"), ("gone/run.json", "does not exist")):
        run("verify", place, directory=tmp_path).refused(6, word)
    (copy / "actions.npz").write_bytes((copy / "actions.npz").read_bytes()[:-30])
    run("verify", copy, directory=tmp_path).refused(6, "actions.npz", "damaged")
