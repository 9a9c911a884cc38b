import pytest

from minitouch_bench.errors import (
    HopelessRunError,
    InfrastructureError,
    RunDirectoryError,
    UsageError,
)
from minitouch_bench.evaluation.actors import prepare_policies
from minitouch_bench.evaluation.engine import EngineOptions
from minitouch_bench.evaluation.journal import read_journal
from minitouch_bench.evaluation.run import open_run
from minitouch_bench.files import ACTIONS_FILE, JOURNAL_FILE
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.policies.limits import limits_of
from minitouch_bench.policies.native import save_native
from minitouch_bench.policies.networks import TouchActor
from minitouch_bench.records import Outcome, Role
from minitouch_bench.workflows import Callbacks
from minitouch_bench.workflows.evaluate import EvaluateOptions, OutputOptions, evaluate
from tests.evaluation.runs import digests, request, run


def test_a_run_holds_every_episode_in_the_suite_s_order(finished):
    done, _ = finished
    assert [record.spec.key for record in done.records] == [
        "pushing/0",
        "pushing/1",
        "opening/0",
        "opening/1",
        "pick-up/0",
        "pick-up/1",
    ]
    assert {record.outcome for record in done.records} == {Outcome.SUCCESS}
    assert done.header.official is False
    assert done.environment.workers == 1
    assert done.environment.packages["pybullet"] == "3.2.7"


def test_two_workers_give_the_same_bits(finished, tmp_path):
    one, directory = finished
    two = run(request(), tmp_path, workers=2)
    assert digests(two) == digests(one)
    assert two.header == one.header
    actions = (tmp_path / ACTIONS_FILE).read_bytes()
    assert actions == (directory / ACTIONS_FILE).read_bytes()


@pytest.mark.slow
def test_a_policy_s_own_chance_comes_from_the_episode_alone(tmp_path):
    wanted = request("random", ("opening",), 2)
    runs = [run(wanted, tmp_path / str(workers), workers) for workers in (1, 2)]
    assert digests(runs[0]) == digests(runs[1])
    one, other = (record.trace.actions for record in runs[0].records)
    assert one[0].tolist() != other[0].tolist()


def cut(source, target, lines, extra=b""):
    """Copy the first lines of a journal, and perhaps a torn one."""
    content = (source / JOURNAL_FILE).read_bytes().splitlines(keepends=True)
    (target / JOURNAL_FILE).write_bytes(b"".join(content[:lines]) + extra)


@pytest.mark.parametrize("lines", [1, 4, 7])
def test_resuming_gives_the_same_run(finished, tmp_path, lines):
    done, directory = finished
    cut(directory, tmp_path, lines, b'{"crc32":"00' if lines < 7 else b"")
    again = run(request(), tmp_path, workers=2, resume=True)
    assert digests(again) == digests(done)
    assert (tmp_path / ACTIONS_FILE).read_bytes() == (directory / ACTIONS_FILE).read_bytes()


@pytest.mark.parametrize(
    ("other", "difference"),
    [
        (request(episodes=3), "episodes: 2 there, 3 asked for"),
        (request(seed=1), "seed: 0 there, 1 asked for"),
        (request(tasks=("pushing",)), "tasks: pushing, opening, pick-up there, pushing asked for"),
        (request("zero"), "policy: scripted there, zero asked for"),
        (request(exploration="zero"), "exploration: none there, zero asked for"),
        (request(act_timeout_s=9.0), "act_timeout_s: 5.0 there, 9.0 asked for"),
    ],
)
def test_a_run_of_other_settings_is_not_resumed(finished, tmp_path, other, difference):
    cut(finished[1], tmp_path, 2)
    with pytest.raises(RunDirectoryError, match="another run") as caught:
        run(other, tmp_path, resume=True)
    assert difference in str(caught.value)


def test_a_directory_that_holds_a_run_is_neither_resumed_nor_replaced_unasked(finished, tmp_path):
    cut(finished[1], tmp_path, 7)
    with pytest.raises(RunDirectoryError, match=r"--resume.*--fresh"):
        run(request(), tmp_path)
    with pytest.raises(UsageError, match="choose one"):
        run(request(), tmp_path, resume=True, fresh=True)
    before = (tmp_path / JOURNAL_FILE).read_bytes()
    assert before == (finished[1] / JOURNAL_FILE).read_bytes()


def test_a_fresh_run_replaces_the_old_one_and_leaves_the_rest(finished, tmp_path):
    cut(finished[1], tmp_path, 7)
    (tmp_path / "notes.txt").write_text("mine")
    done = run(request(tasks=("opening",), episodes=1), tmp_path, fresh=True)
    assert [record.spec.key for record in done.records] == ["opening/0"]
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("name", ["notes.txt", "report.md", "actions.npz", "videos"])
def test_a_directory_of_other_files_is_refused_and_fresh_keeps_them(tmp_path, name):
    (tmp_path / name / "x" if name == "videos" else tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name / "x" if name == "videos" else tmp_path / name).write_text("mine")
    for resume in (False, True):
        with pytest.raises(RunDirectoryError, match=f"holds no run: '{name}'"):
            open_run(request(), tmp_path, resume=resume, fresh=False)
    (tmp_path / "notes.txt").write_text("mine")
    open_run(request(), tmp_path, resume=False, fresh=True)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert name != "videos" or (tmp_path / "videos" / "x").read_text() == "mine"


def test_resuming_what_never_began_begins(tmp_path):
    done = run(request(tasks=("opening",), episodes=1), tmp_path, resume=True)
    assert len(done.records) == 1


def test_faults_stay_in_the_denominator_and_the_rest_goes_on(tmp_path, importable):
    wanted = request("misbehaved:FaultInPushing", ("pushing", "opening"), 1)
    done = run(wanted, tmp_path)
    pushing, opening = done.records
    assert pushing.outcome is Outcome.POLICY_FAULT
    assert "NaN" in pushing.fault
    assert len(pushing.trace.actions) == 2
    assert opening.outcome is Outcome.STEP_LIMIT
    assert opening.fault == ""


def test_a_run_that_begins_with_ten_faults_ends_and_can_be_resumed(tmp_path, importable):
    wanted = request("misbehaved:Hopeless", ("opening",), 12)
    with pytest.raises(HopelessRunError, match="policy faults: the policy said: ValueError"):
        run(wanted, tmp_path)
    assert len(read_journal(tmp_path).records) == 10
    done = run(wanted, tmp_path, resume=True)
    assert [record.outcome for record in done.records] == [Outcome.POLICY_FAULT] * 12


def test_ten_faults_are_a_whole_run_and_nine_are_no_reason(tmp_path, importable, monkeypatch):
    wanted = request("misbehaved:Hopeless", ("opening",), 10)
    assert len(run(wanted, tmp_path / "whole").records) == 10
    wanted = request("misbehaved:Hopeless", ("opening",), 11, isolation=Isolation.PROCESS)
    monkeypatch.setenv("FINE", str(wanted.specs()[3].policy_seed))
    monkeypatch.setattr("minitouch_bench.evaluation.run.HOPELESS_AFTER", 4)
    assert len(run(wanted, tmp_path / "fine").records) == 11


def test_a_run_of_other_packages_is_not_resumed(tmp_path, monkeypatch):
    wanted = request("zero", ("opening",), 1)
    open_run(wanted, tmp_path, resume=False, fresh=False)
    monkeypatch.setattr(
        "minitouch_bench.evaluation.run.package_versions", lambda: {"torch": "99.0"}
    )
    with pytest.raises(RunDirectoryError, match=r"torch \S+ there, 99\.0 here") as refused:
        open_run(wanted, tmp_path, resume=True, fresh=False)
    assert "--fresh" in str(refused.value)


def test_another_episode_timeout_is_unofficial_and_another_run(tmp_path):
    usual, other = (
        request("zero", ("opening",), 1),
        request("zero", ("opening",), 1, episode_timeout_s=600.0),
    )
    assert "600 s per episode" in other.header().unofficial_because
    assert not any("per episode" in reason for reason in usual.header().unofficial_because[1:])
    run(other, tmp_path)
    assert read_journal(tmp_path).header == other.header()
    assert limits_of(other.header()).episode_timeout_s == 600.0
    with pytest.raises(RunDirectoryError, match=r"600\.0 there, the usual asked for"):
        run(usual, tmp_path, resume=True)


def test_a_factory_cannot_read_the_journal_of_its_run(tmp_path, importable, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (record,) = run(request("misbehaved:ReadsItsRun", ("opening",), 1), tmp_path / "run").records
    assert record.fault.startswith("the policy said: PermissionError")


def test_exploration_is_run_beside_the_final_policy(tmp_path):
    wanted = request("scripted", ("playing", "opening"), 1, exploration="zero")
    done = run(wanted, tmp_path)
    assert [record.spec.key for record in done.records] == [
        "playing/0",
        "opening/0",
        "exploration/opening/0",
    ]
    final, exploration = done.records[1:]
    assert (final.outcome, exploration.outcome) == (Outcome.SUCCESS, Outcome.STEP_LIMIT)
    assert exploration.spec.role is Role.EXPLORATION
    assert exploration.spec.seed == final.spec.seed


@pytest.fixture
def deaths_file(tmp_path, monkeypatch):
    """Where a policy reads how often it is still to be killed."""
    monkeypatch.setenv("DEATHS", str(tmp_path / "deaths"))
    return tmp_path / "deaths"


@pytest.mark.parametrize("deaths", [1, 2])
def test_a_policy_killed_from_outside_is_tried_again_with_the_same_result(
    deaths_file, importable, deaths
):
    place = deaths_file.parent
    wanted = request("misbehaved:IsKilled", ("opening",), 1, isolation=Isolation.PROCESS)
    deaths_file.write_text("0")
    quiet = run(wanted, place / "quiet")
    deaths_file.write_text(str(deaths))
    assert digests(run(wanted, place / "killed")) == digests(quiet)
    assert deaths_file.read_text() == "0"


@pytest.mark.parametrize(
    ("policy", "deaths", "fault"),
    [
        ("IsKilled", 3, "was killed by SIGKILL"),
        ("TriesItsLuck", 1, "did not repeat its actions"),
        ("ForgetsInBetween", 2, "did not repeat its actions"),
        ("KillsItsWorker", 1, "did not repeat its actions"),
    ],
)
def test_a_policy_gains_nothing_by_being_killed(deaths_file, importable, policy, deaths, fault):
    deaths_file.write_text(str(deaths))
    wanted = request(f"misbehaved:{policy}", ("opening",), 1, isolation=Isolation.PROCESS)
    (record,) = run(wanted, deaths_file.parent / "run").records
    assert record.outcome is Outcome.POLICY_FAULT
    assert fault in record.fault


def test_a_resumed_run_holds_a_policy_to_the_actions_of_before(deaths_file, importable):
    place = deaths_file.parent / "run"
    deaths_file.write_text("3")
    wanted = request("misbehaved:KillsItsWorker", ("opening",), 1, isolation=Isolation.PROCESS)
    with pytest.raises(InfrastructureError):
        run(wanted, place)
    assert [path.name for path in (place / "attempts").iterdir()] == ["opening-0"]
    (record,) = run(wanted, place, resume=True).records
    assert "did not repeat its actions" in record.fault
    assert not (place / "attempts").exists()


def test_resuming_what_was_never_begun_is_told(tmp_path):
    told = []
    options = EvaluateOptions(
        "zero",
        tasks=("opening",),
        episodes=1,
        engine=EngineOptions(workers=1),
        output=OutputOptions(tmp_path / "run", resume=True),
    )
    for _ in range(2):
        evaluate(options, Callbacks(note=told.append))
    assert told == [f"there is no run in {tmp_path / 'run'} to resume: a new one begins"]


def test_a_policy_named_after_one_task_that_plays_others_is_told(tmp_path):
    told = []
    file = tmp_path / "pushing.safetensors"
    save_native(TouchActor(action_size=4), file)
    for tasks in (("pushing",), ("pushing", "opening")):
        prepare_policies(file, tasks, note=told.append)
    (line,) = told
    assert line.startswith(f"{file} is named after pushing and plays pushing, opening: ")
