import json
import socket
from dataclasses import replace

import numpy as np
import pytest

import minitouch_bench as mt
from minitouch_bench.runs.run import make_header, read_run, run_json
from tests.commands.command import run
from tests.evaluation.misbehaved import Still

ONE = ("--tasks", "pushing", "--episodes", "1", "--workers", "1")


def test_a_true_run_is_verified_and_run_again(scripted):
    directory = scripted[1]
    done = run("verify", directory, "--rerun", 2, directory=directory.parent)
    assert done.code == 0, done.err
    assert "4 episodes replayed" in done.out
    assert "2 episodes run again with the checkpoint" in done.out
    assert "is verified" in done.out


def test_an_edited_run_is_named_with_exit_1(copy):
    text = (copy / "run.json").read_text()
    text = text.replace('"outcome": "success"', '"outcome": "step_limit"', 1)
    (copy / "run.json").write_text(text)
    done = run("verify", copy, "--rerun", 2, "--json", directory=copy.parent)
    assert done.code == 1
    result = json.loads(done.out)
    assert result["passed"] is False
    assert result["reran"] == 0
    assert result["problems"][0]["place"] == "digest"
    plain = run("verify", copy, directory=copy.parent)
    assert plain.code == 1
    assert "digest: " in plain.out
    assert "is not verified" in plain.out


def test_a_run_is_verified_without_its_checkpoint_and_run_again_with_it_alone(tmp_path):
    from minitouch_bench.policies.native import save_native
    from minitouch_bench.policies.networks import TouchActor

    policy = tmp_path / "policy.safetensors"
    save_native(TouchActor(action_size=4), policy)
    both = ("evaluate", policy, "--exploration", policy)
    done = run(*both, *ONE, "--output", "run", directory=tmp_path)
    assert done.code == 0, done.err
    with np.load(tmp_path / "run" / "actions.npz") as actions:  # the one samples, the other not
        first, sampled = actions["pushing/0"], actions["exploration/pushing/0"]
    assert not np.array_equal(first[0], sampled[0])
    moved = policy.rename(tmp_path / "moved.safetensors")
    assert run("verify", "run", directory=tmp_path).code == 0
    run("verify", "run", "--policy", moved, directory=tmp_path).refused(2, "need --rerun N")
    run("verify", "run", "--rerun", 1, directory=tmp_path).refused(5, "is gone", "--policy")
    here = ("--policy", moved, "--exploration", moved)
    again = run("verify", "run", "--rerun", 1, *here, directory=tmp_path)
    assert again.code == 0, again.err
    assert "2 episodes run again with the checkpoint" in again.out
    save_native(TouchActor(action_size=4), moved)
    other = run("verify", "run", "--rerun", 1, *here, directory=tmp_path)
    other.refused(2, "is not the policy of this run")


def of_policy(directory, **policy):
    """Say that a run's policy is another one."""
    run = read_run(directory)
    header = run.header
    header = make_header(header.plan, replace(header.policy, **policy), None, header.isolation)
    (directory / "run.json").write_bytes(run_json(replace(run, header=header)))


def test_a_server_that_a_run_names_is_contacted_only_if_the_user_names_it(copy):
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.0)
        address = f"http://127.0.0.1:{server.getsockname()[1]}"
        of_policy(copy, kind="remote", source=address, notes=("remote",))
        unnamed = run("verify", copy, "--rerun", 1, directory=copy.parent)
        unnamed.refused(5, address, "contacted only if you name it", "--policy")
        with pytest.raises(BlockingIOError):
            server.accept()


def test_python_code_that_a_run_names_is_run_only_if_the_user_names_it(copy):
    of_policy(copy, kind="factory", source="misbehaved:Still", notes=())
    unnamed = run("verify", copy, "--rerun", 1, "--trust", directory=copy.parent)
    unnamed.refused(5, "misbehaved:Still", "run only if you name it", "--policy")


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


# replay


def test_an_episode_is_looked_at_beside_its_run(copy):
    done = run("replay", copy, "opening/1", "--csv", "--video", directory=copy.parent)
    assert done.code == 0, done.err
    files = [copy / "replays" / f"opening-1.{suffix}" for suffix in ("html", "mp4", "csv")]
    assert done.out.split() == list(map(str, files))
    assert all(path.stat().st_size > 1000 for path in files)
    assert "success after" in done.err
    assert "the same bits as recorded" in done.err
    assert run("verify", copy, directory=copy.parent).code == 0  # a view changes no report


def test_an_episode_that_is_not_there_is_said(scripted):
    directory = scripted[1]
    run("replay", directory, "pick-up/0", directory=directory.parent).refused(2, "pushing/0")
    wrong = run("replay", directory, "pushing/0", "--output", "x.avi", directory=directory.parent)
    wrong.refused(2, ".html", "x.avi")
    assert not (directory / "replays").exists()


# doctor


def test_the_doctor_finds_this_machine_sound(tmp_path):
    done = run("doctor", "--json", "--workers", 2, directory=tmp_path)
    assert done.code == 0, done.out + done.err
    result = json.loads(done.out)
    verdicts = {check["name"]: check["verdict"] for check in result["checks"]}
    assert result["healthy"] is True
    wanted = {"isolation", "policy repeats", "order and workers"}
    assert {name for name in wanted if verdicts[name] == "ok"} == wanted
    assert "fail" not in verdicts.values()


def test_the_doctor_names_what_is_wrong(tmp_path, monkeypatch):
    (tmp_path / "cache").write_text("no directory")
    monkeypatch.setenv("MINITOUCH_CACHE", str(tmp_path / "cache"))
    done = run("doctor", directory=tmp_path)
    assert done.code == 1
    assert "cache" in done.out
    assert "cannot be written" in " ".join(done.out.split())
    assert "Not to be trusted yet: cache" in done.out
