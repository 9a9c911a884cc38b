from dataclasses import replace
from pathlib import Path

import pytest

from minitouch_bench.api import evaluate
from minitouch_bench.episode import Outcome
from minitouch_bench.errors import (
    CheckpointChangedError,
    HopelessRunError,
    InfrastructureError,
    RunDirectoryError,
)
from minitouch_bench.evaluation.engine import Callbacks, LocalEngine
from minitouch_bench.evaluation.execution import (
    header_of,
    open_run,
    resumable,
    run_name,
)
from minitouch_bench.files import ACTIONS_FILE, JOURNAL_FILE
from minitouch_bench.machine import installed_versions
from minitouch_bench.policies.policy import Isolation
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.simulation.builds import BUILDS
from tests.evaluation.runs import digests, request, run


def test_a_run_names_its_workers_and_the_build_of_its_simulator(finished):
    environment = finished[0].environment
    assert environment.workers == 1
    assert environment.packages.items() >= installed_versions(BUILDS).items()


def begin(source, target, count):
    """Copy a run's journal up to its first episodes, as one worker wrote them."""
    lines = (source / JOURNAL_FILE).read_bytes().split(b"\n")
    (target / JOURNAL_FILE).write_bytes(b"\n".join(lines[: count + 1]))


@pytest.mark.parametrize("count", [0, 3, 6])
def test_resuming_gives_the_same_run(finished, tmp_path, count):
    done, directory = finished
    begin(directory, tmp_path, count)
    again = run(request(), tmp_path, workers=2, resume=True)
    assert digests(again) == digests(done)
    assert (tmp_path / ACTIONS_FILE).read_bytes() == (directory / ACTIONS_FILE).read_bytes()


@pytest.mark.parametrize(
    ("other", "difference"),
    [
        (request(episodes=3), "episodes: 2 there, 3 asked for"),
        (request(tasks=("pushing",)), "tasks: pushing, opening, pick-up there, pushing asked for"),
        (request("zero"), "policy: scripted there, zero asked for"),
        (request(exploration="zero"), "exploration: none there, zero asked for"),
        (request(act_timeout_s=9.0), "act_timeout_s: 5.0 there, 9.0 asked for"),
    ],
)
def test_a_run_of_other_settings_is_not_resumed(finished, tmp_path, other, difference):
    begin(finished[1], tmp_path, 1)
    with pytest.raises(RunDirectoryError, match="another run") as caught:
        run(other, tmp_path, resume=True)
    assert difference in str(caught.value)


def test_a_difference_is_said_without_its_consequences(tmp_path):
    open_run(header_of(request(tasks=("pick-up",), episodes=10)), tmp_path)
    official = request(tasks=PROTOCOL.suite("table4").tasks, episodes=100)
    for resume in (False, True):
        with pytest.raises(RunDirectoryError) as refused:
            open_run(header_of(official), tmp_path, resume=resume)
        assert str(refused.value).count("asked for") == 2


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({}, "zero-table4"),
        ({"tasks": ["pick-up"], "episodes": 10}, "zero-table4-pick-up-10-episodes"),
        ({"episodes": 1, "seed": 7}, "zero-table4-1-episode-seed-7"),
        ({"episodes_from": ["pushing/3,17"]}, "zero-table4-pushing-3-pushing-17"),
        ({"objects": "cube"}, "zero-table4-objects-cube"),
    ],
)
def test_a_run_is_named_after_what_differs_from_its_suite(options, name):
    plan = make_plan(**{"suite": "table4", **options})
    assert run_name(header_of(replace(request("zero"), plan=plan))) == name


def test_a_long_name_of_a_run_is_cut_and_stays_its_own():
    names = set()
    for last in range(50, 60):
        chosen = f"pushing/{','.join(map(str, range(50)))},{last}"
        setup = replace(request("zero"), plan=make_plan("table4", episodes_from=[chosen]))
        names.add(run_name(header_of(setup)))
    assert len(names) == 10
    assert all(name.startswith("zero-table4-pushing-0-pushing-1-") for name in names)
    assert max(map(len, names)) <= len("zero-table4-") + 80


def test_a_fresh_run_replaces_the_old_one_and_leaves_the_rest(finished, tmp_path):
    begin(finished[1], tmp_path, 6)
    (tmp_path / "notes.txt").write_text("mine")
    done = run(request(tasks=("opening",), episodes=1), tmp_path, fresh=True)
    assert [spec.key for spec, _ in done.specs_and_rows()] == ["opening/0"]
    assert (tmp_path / JOURNAL_FILE).read_bytes().count(b"\n") == 1
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_directory_of_other_files_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    for resume in (False, True):
        with pytest.raises(RunDirectoryError, match="does not contain a run"):
            open_run(header_of(request()), tmp_path, resume=resume, fresh=False)


def test_a_run_that_begins_with_ten_faults_ends_and_can_be_resumed(tmp_path):
    wanted = request("misbehaved:Hopeless", ("opening",), 12)
    with pytest.raises(HopelessRunError, match="policy faults: the policy said: ValueError"):
        run(wanted, tmp_path)
    assert (tmp_path / JOURNAL_FILE).read_bytes().count(b"\n") == 10
    done = run(wanted, tmp_path, resume=True)
    assert [row.outcome for row in done.rows] == [Outcome.POLICY_FAULT] * 12


@pytest.mark.parametrize(
    ("error", "directory", "advice"),
    [
        (HopelessRunError, None, "Correct the policy and repeat$"),
        (HopelessRunError, Path("run"), "Correct the policy and repeat .* --fresh; or --resume"),
        (CheckpointChangedError, Path("run"), "--resume continues with the old file, --fresh"),
    ],
)
def test_an_error_that_ends_a_run_says_how_to_go_on(error, directory, advice):
    with pytest.raises(error, match=f"^why\n.*{advice}"), resumable(directory):
        raise error("why")


class Backwards(LocalEngine):
    """The last episodes end first, as faults do beside the long episode of another worker."""

    def run(self, source, specs):
        return super().run(source, specs[::-1])


def test_the_first_episodes_are_those_of_the_plan_whatever_ends_first(tmp_path, monkeypatch):
    wanted = request("misbehaved:Hopeless", ("opening",), 11, isolation=Isolation.PROCESS)
    monkeypatch.setenv("FINE", str(wanted.plan.specs()[0].policy_seed))
    done = run(wanted, tmp_path, engine=Backwards(1))
    assert len(done.faults) == 10


def test_a_run_of_other_packages_is_not_resumed(tmp_path, monkeypatch):
    wanted = request("zero", ("opening",), 1)
    open_run(header_of(wanted), tmp_path, resume=False, fresh=False)
    monkeypatch.setattr(
        "minitouch_bench.evaluation.execution.package_versions", lambda: {"torch": "99.0"}
    )
    with pytest.raises(RunDirectoryError, match=r"torch \S+ there, 99\.0 here") as refused:
        open_run(header_of(wanted), tmp_path, resume=True, fresh=False)
    assert "--fresh" in str(refused.value)


def test_a_factory_cannot_read_what_its_run_keeps(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = run(request("misbehaved:ReadsItsRun", ("opening",), 1), tmp_path / "run")
    assert done.faults["opening/0"].startswith("the policy said: PermissionError")


def test_exploration_is_run_beside_the_final_policy(tmp_path):
    wanted = request("scripted", ("playing", "opening"), 1, exploration="zero")
    done = run(wanted, tmp_path)
    keys = [spec.key for spec, _ in done.specs_and_rows()]
    assert keys == ["playing/0", "opening/0", "exploration/opening/0"]
    final, exploration = done.rows[1], done.exploration_rows[0]
    assert (final.outcome, exploration.outcome) == (Outcome.SUCCESS, Outcome.STEP_LIMIT)
    assert exploration.seed == final.seed


@pytest.fixture
def deaths_file(tmp_path, monkeypatch):
    """Where a policy reads how often it is still to be killed."""
    monkeypatch.setenv("DEATHS", str(tmp_path / "deaths"))
    return tmp_path / "deaths"


def test_a_policy_killed_from_outside_is_tried_again_with_the_same_result(deaths_file):
    place = deaths_file.parent
    wanted = request("misbehaved:IsKilled", ("opening",), 1, isolation=Isolation.PROCESS)
    deaths_file.write_text("0")
    quiet = run(wanted, place / "quiet")
    deaths_file.write_text("2")
    assert digests(run(wanted, place / "killed")) == digests(quiet)
    assert deaths_file.read_text() == "0"


def test_a_policy_killed_three_times_leaves_the_run_incomplete(deaths_file):
    place = deaths_file.parent / "run"
    deaths_file.write_text("3")
    wanted = request("misbehaved:IsKilled", ("opening",), 1, isolation=Isolation.PROCESS)
    with pytest.raises(InfrastructureError, match=r"opening/0 failed 3 times.*SIGKILL"):
        run(wanted, place)
    assert (place / JOURNAL_FILE).read_bytes().count(b"\n") == 0
    assert not run(wanted, place, resume=True).faults


def test_what_there_is_to_resume_is_said_and_the_views_are_written_again(tmp_path):
    notes, directory = [], tmp_path / "run"
    options = {"tasks": "opening", "episodes": 1, "workers": 1, "output": directory}
    options |= {"resume": True, "callbacks": Callbacks(note=notes.append)}
    first = evaluate("zero", **options)
    assert not (directory / JOURNAL_FILE).exists()
    content = {path.name: path.read_bytes() for path in directory.iterdir()}
    (directory / "report.html").unlink()
    (directory / "episodes.csv").write_text("edited")
    (directory / JOURNAL_FILE).touch()  # a crash after the last file left it
    again = evaluate("zero", **options)
    assert again == first
    assert content == {path.name: path.read_bytes() for path in directory.iterdir()}
    assert notes == [
        f"no run to resume in {directory}: starting a new one",
        f"{directory} contains the finished run: no episode is missing",
    ]
