import numpy as np
import pytest

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.evaluation.engine import LocalEngine
from minitouch_bench.files import ACTIONS_FILE, JOURNAL_FILE, PACKED_RUN_FILE
from minitouch_bench.runs.run import read_run
from minitouch_bench.verification.static_check import Problem, check_run, compare_values
from tests.altered import ROOT, edit_document
from tests.evaluation.runs import Here
from tests.verification.conftest import verify_run


def swap(actions):
    actions["opening/0"], actions["opening/1"] = actions["opening/1"], actions["opening/0"]


def nudge(actions):
    actions["opening/1"][3, 0] = np.nextafter(actions["opening/1"][3, 0], np.float32(0))


def edit_actions(run, change):
    with np.load(run / ACTIONS_FILE) as archive:
        actions = dict(archive)
    change(actions)
    np.savez_compressed(run / ACTIONS_FILE, **actions)


def verify(directory):
    return verify_run(read_run(directory), Here())


def places(directory):
    """Return where a run differs from its episodes."""
    return [problem.place for problem in verify(directory).problems]


def test_a_true_run_is_verified_episode_by_episode_and_no_view_is_read_back(copy):
    seen = []
    (copy / "report.html").unlink()
    (copy / "episodes.csv").write_text("somebody's own")
    result = verify_run(read_run(copy), LocalEngine(2), seen.append)
    assert result.problems == ()
    assert result.passed
    assert result.replayed == len(seen) == 8


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("outcome", "left_workspace"),
        ("touch_interaction", 9999),
        ("contact_force", None),
        (
            "start",
            {"position": [0.5, 0.0, 0.1], "yaw": 0.0, "target": None, "end_effector": [0.0] * 3},
        ),
        ("clipped_actions", 200),
        ("digest", "0" * 64),
    ],
)
def test_no_figure_of_an_episode_can_be_edited(copy, name, value):
    edit_document(copy / "run.json", lambda d: d["episodes"][0].update({name: value}))
    found = places(copy)
    assert found
    assert all(
        place in {"pushing/0", "digest"} or place.startswith("summary.tasks[0].estimates.")
        for place in found
    )


def test_the_last_bit_counts(copy):
    def move(document):
        row = document["episodes"][1]
        row["object_movement"] = float(np.nextafter(row["object_movement"], 1))

    edit_document(copy / "run.json", move)
    assert places(copy) == ["pushing/1"]


def first_task(document):
    return document["summary"]["tasks"][0]


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (
            lambda d: first_task(d)["estimates"]["success"].update(value=1.0, low=0.97),
            "summary.tasks[0].estimates.success.low",
        ),
        (
            lambda d: first_task(d)["estimates"].pop("arm_time"),
            "summary.tasks[0].estimates.arm_time",
        ),
        (lambda d: first_task(d)["touch_curve"].append(0.0), "curves of pushing"),
        (
            lambda d: first_task(d)["force_curve"].__setitem__(0, [0.0, 1.0, 2.0]),
            "curves of pushing",
        ),
        (lambda d: d.update(digest="f" * 64), "digest"),
        (lambda d: d["header"].update(official=True), "header.official"),
        (lambda d: d["header"].update(isolation="sandbox"), "header.isolation"),
        (lambda d: d["header"]["plan"].update(suite="easy"), "header.plan"),
        (lambda d: d["header"]["task_digests"].update(pushing="0" * 64), "protocol"),
        (lambda d: d["episodes"].pop(1), "pushing/1"),
        (lambda d: d["exploration_episodes"].clear(), "exploration/pushing/0"),
        (lambda d: d["episodes"].reverse(), "pushing/0"),
        (lambda d: d["episodes"][0].update(shape="held-out-7"), "pushing/0"),
        (lambda d: d["faults"].update({"pushing/0": "none"}), "faults"),
    ],
)
def test_nothing_else_of_the_document_can_be_edited(copy, change, place):
    edit_document(copy / "run.json", change)
    assert any(found.startswith(place) for found in places(copy))


@pytest.mark.parametrize(("change", "place"), [(swap, "opening/0"), (nudge, "opening/1")])
def test_no_action_can_be_edited_or_left_out(copy, change, place):
    edit_actions(copy, change)
    assert place in places(copy)
    edit_actions(copy, lambda actions: actions.pop("exploration/opening/0"))
    with pytest.raises(RunDirectoryError, match="no actions of exploration/opening/0"):
        verify(copy)


def test_an_unfinished_run_is_refused_with_the_way_to_finish_it(tmp_path):
    (tmp_path / JOURNAL_FILE).touch()
    with pytest.raises(RunDirectoryError, match=r"unfinished run: .* --resume"):
        verify(tmp_path)


def test_each_difference_is_placed_and_what_a_stranger_wrote_reaches_no_terminal():
    text = str(Problem("\x1b[31m", "\x1b[2J\n" + "x" * 10_000))
    assert text.isprintable()
    assert len(text) < 500
    (wrong,) = compare_values("run", {"a": [1, 2]}, {"a": [1, 3]})
    assert str(wrong) == "run.a[1]: 2 recorded, 3 found"
    (more,) = compare_values("run", {"a": 1}, {})
    assert str(more) == "run.a: should not be there"
    for one, other in ((20.0, 20.0 * (1 + 1e-10)), (0.0, 1e-17)):  # rounding
        assert [*compare_values("run", one, other)] == []


@pytest.mark.slow
def test_every_number_of_the_stored_rows_follows_from_their_episodes():
    files = [*(ROOT / "reports" / "results").rglob(PACKED_RUN_FILE)]
    assert len(files) >= 50
    assert {path: check_run(read_run(path)) for path in files} == dict.fromkeys(files, ())
