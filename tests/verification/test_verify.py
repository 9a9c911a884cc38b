import numpy as np
import pytest

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.evaluation.engine import LocalEngine
from minitouch_bench.files import JOURNAL_FILE
from minitouch_bench.runs.run import read_run
from tests.altered import edit_actions, edit_document, nudge, swap
from tests.evaluation.runs import Here
from tests.verification.conftest import verify_run


def places(directory):
    """Return where a run differs from its episodes."""
    return [problem.place for problem in verify(directory).problems]


def verify(directory):
    return verify_run(read_run(directory), Here())


def test_a_true_run_is_verified_episode_by_episode(whole):
    seen = []
    result = verify_run(read_run(whole), LocalEngine(2), seen.append)
    assert result.problems == ()
    assert result.passed
    assert result.replayed == len(seen) == 8


FIRST_EPISODE = {
    "outcome": "left_workspace",
    "steps": 7,
    "episode_return": 24.0,
    "touch_interaction": 9999,
    "touch_onsets": 0,
    "touch_steps": 0,
    "touch_variance": 1.0,
    "peak_force": 1.0,
    "contact_force": None,
    "start": {
        "position": [0.5, 0.0, 0.1],
        "yaw": 0.0,
        "target": None,
        "end_effector": [0.5, 0.0, 0.1],
    },
    "object_movement": 1e-30,
    "first_touch_tick": None,
    "ticks": 60,
    "clipped_actions": 200,
    "digest": "0" * 64,
}


@pytest.mark.parametrize("name", FIRST_EPISODE)
def test_no_figure_of_an_episode_can_be_edited(copy, name):
    edit_document(
        copy / "run.json",
        lambda d: d["episodes"][0].update({name: FIRST_EPISODE[name]}),
    )
    assert all(
        place in {"pushing/0", "digest"} or place.startswith("summary.tasks[0].estimates.")
        for place in places(copy)
    )
    assert places(copy)


def test_the_last_bit_counts(copy):
    def nudge(document):
        row = document["episodes"][1]
        row["object_movement"] = float(np.nextafter(row["object_movement"], 1))

    edit_document(copy / "run.json", nudge)
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
        (lambda d: first_task(d)["curve_episodes"].pop(), "curves of pushing"),
        (lambda d: d.update(digest="f" * 64), "digest"),
        (lambda d: d["header"].update(official=True), "header.official"),
        (lambda d: d["header"].update(unofficial_because=["x"]), "header.unofficial_because"),
        (lambda d: d["header"].update(isolation="sandbox"), "header.isolation"),
        (lambda d: d["header"]["plan"].update(suite="easy"), "header.plan"),
        (lambda d: d["header"]["plan"].update(chosen=["pushing/0"]), "header.plan"),
        (lambda d: d["header"]["task_digests"].update(pushing="0" * 64), "protocol"),
        (lambda d: d["episodes"].pop(1), "pushing/1"),
        (lambda d: d["exploration_episodes"].clear(), "exploration/pushing/0"),
        (lambda d: d["episodes"].append(d["episodes"][0]), "pushing/0"),
        (lambda d: d["episodes"].reverse(), "pushing/0"),
        (lambda d: d["episodes"][0].update(seed=1), "pushing/0"),
        (lambda d: d["episodes"][0].update(shape="held-out-7"), "pushing/0"),
        (lambda d: d["faults"].update({"pushing/0": "none"}), "faults"),
    ],
)
def test_nothing_else_of_the_document_can_be_edited(copy, change, place):
    edit_document(copy / "run.json", change)
    assert any(found.startswith(place) for found in places(copy))


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (swap, "opening/0"),
        (nudge, "opening/1"),
    ],
)
def test_no_action_can_be_edited(copy, change, place):
    edit_actions(copy, change)
    assert place in places(copy)


def test_an_episode_without_its_actions_is_named(copy):
    edit_actions(copy, lambda actions: actions.pop("exploration/opening/0"))
    with pytest.raises(RunDirectoryError, match="no actions of exploration/opening/0"):
        verify(copy)


def test_a_view_is_never_read_back(copy):
    (copy / "report.html").unlink()
    (copy / "episodes.csv").write_text("somebody's own")
    assert places(copy) == []


def test_what_is_no_run_is_said(tmp_path):
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun" / JOURNAL_FILE).touch()
    with pytest.raises(RunDirectoryError, match=r"unfinished run: .* --resume"):
        verify(tmp_path / "begun")
    with pytest.raises(RunDirectoryError, match="is not a run"):
        verify(tmp_path)
