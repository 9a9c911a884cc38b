import json
import re
import zlib

import numpy as np
import pytest

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.evaluation.local_engine import LocalEngine
from minitouch_bench.files import JOURNAL_FILE
from minitouch_bench.verification.verify import verify_run
from tests.verification.conftest import Here, edit_actions, edit_document


def places(directory):
    """Return where a run differs from its episodes."""
    return [problem.place for problem in verify_run(directory, Here()).problems]


def test_a_true_run_is_verified_episode_by_episode(whole):
    seen = []
    result = verify_run(whole, LocalEngine(2), seen.append)
    assert result.problems == ()
    assert result.passed
    assert result.episodes == len(seen) == 8


def test_what_a_packed_run_lacks_is_no_difference(copy):
    for name in (JOURNAL_FILE, "report.md", "report.html", "episodes.csv", "table4.csv"):
        (copy / name).unlink()
    assert places(copy) == []


FIRST_EPISODE = {
    "outcome": "left_workspace",
    "steps": 7,
    "episode_return": 24.0,
    "touch_interaction": 9999,
    "touch_onsets": 0,
    "touch_steps": 0,
    "touch_variance": 1.0,
    "object_movement": 1e-30,
    "first_touch_tick": None,
    "ticks": 60,
    "clipped_actions": 200,
    "digest": "0" * 64,
}


@pytest.mark.parametrize("name", FIRST_EPISODE)
def test_no_figure_of_an_episode_can_be_edited(copy, name):
    edit_document(
        copy, lambda document: document["episodes"][0].update({name: FIRST_EPISODE[name]})
    )
    assert f"pushing/0.{name}" in places(copy)


def test_the_last_bit_counts(copy):
    def nudge(document):
        row = document["episodes"][1]
        row["object_movement"] = float(np.nextafter(row["object_movement"], 1))

    edit_document(copy, nudge)
    assert places(copy) == ["pushing/1.object_movement", "episodes.csv"]


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
            lambda d: first_task(d)["outcomes"].update(success=100),
            "summary.tasks[0].outcomes.success",
        ),
        (
            lambda d: first_task(d)["estimates"].pop("arm_time"),
            "summary.tasks[0].estimates.arm_time",
        ),
        (lambda d: d.update(digest="f" * 64), "digest"),
        (lambda d: d["header"].update(official=True), "header.official"),
        (
            lambda d: d["header"].update(official=True, unofficial_because=[]),
            "header.unofficial_because",
        ),
        (lambda d: d["header"].update(unofficial_because=["x"]), "header.unofficial_because"),
        (lambda d: d["header"].update(suite="easy"), "header.suite"),
        (lambda d: d["header"].update(tasks=["opening", "pushing"]), "header.tasks"),
        (lambda d: d["header"].update(episodes=10**9), "header.episodes"),
        (lambda d: d["header"].update(chosen_episodes=[]), "header.chosen_episodes"),
        (lambda d: d["header"].update(chosen_episodes=["pushing/0"]), "header.chosen_episodes"),
        (lambda d: d["header"]["task_digests"].update(pushing="0" * 64), "protocol"),
        (lambda d: d["header"]["policy"].update(name="a better one"), "journal.jsonl"),
        (lambda d: d["episodes"].pop(1), "pushing/1"),
        (lambda d: d["exploration_episodes"].clear(), "exploration/pushing/0"),
        (lambda d: d["episodes"].append(d["episodes"][0]), "pushing/0"),
        (lambda d: d["episodes"].reverse(), "pushing/0"),
        (lambda d: d["episodes"][0].update(seed=1), "pushing/0"),
        (lambda d: d["episodes"][0].update(shape="held-out-7"), "pushing/0"),
        (lambda d: d["header"].update(episodes=3), "header.unofficial_because"),
        (lambda d: d["faults"].update({"pushing/0": "none"}), "journal.jsonl"),
    ],
)
def test_nothing_else_of_the_document_can_be_edited(copy, change, place):
    edit_document(copy, change)
    assert place in places(copy)


def swap(actions):
    actions["pushing/0"], actions["pushing/1"] = actions["pushing/1"], actions["pushing/0"]


def nudge(actions):
    step = actions["opening/1"][3]
    step[0] = np.nextafter(step[0], np.float32(0))


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (swap, "pushing/0.digest"),
        (nudge, "opening/1.digest"),
        (lambda a: a.update({"pushing/0": a["pushing/0"][:-1]}), "pushing/0.digest"),
        (lambda a: a.update({"pushing/0": np.zeros((5, 4), np.float32)}), "pushing/0.digest"),
        (lambda a: a.pop("exploration/opening/0"), "exploration/opening/0"),
    ],
)
def test_no_action_can_be_edited(copy, change, place):
    edit_actions(copy, change)
    assert place in places(copy)


def test_a_changed_action_has_one_line(copy):
    edit_actions(copy, nudge)
    (problem,) = verify_run(copy, Here()).problems
    assert re.fullmatch(
        r"opening/1\.digest: its actions do not give the episode recorded: other [a-z_, ]*digest",
        str(problem),
    )


def test_actions_after_the_end_are_found_too(copy):
    last = np.zeros((1, 4), np.float32)
    edit_actions(copy, lambda a: a.update({"pushing/0": np.vstack([a["pushing/0"], last])}))
    (problem,) = verify_run(copy, Here()).problems
    assert re.fullmatch(
        r"pushing/0: (\d+) actions recorded, the episode ends after \d+", str(problem)
    )


@pytest.mark.parametrize("name", ["episodes.csv", "exploration.csv", "table4.csv", "report.md"])
def test_no_table_can_be_edited(copy, name):
    file = copy / name
    content = file.read_text()
    at = next(i for i, c in enumerate(content) if c.isdigit() and content[:i].count("\n") > 1)
    digit = "3" if content[at] != "3" else "4"
    file.write_text(content[:at] + digit + content[at + 1 :])
    assert places(copy) == [name]


def test_no_record_of_the_journal_can_be_edited(copy):
    lines = (copy / JOURNAL_FILE).read_bytes().splitlines(keepends=True)
    body = json.loads(lines[2])["body"]
    body["outcome"] = "step_limit"
    text = json.dumps(body, separators=(",", ":")).encode()
    lines[2] = b'{"crc32":"%08x","body":%b}\n' % (zlib.crc32(text), text)
    (copy / JOURNAL_FILE).write_bytes(b"".join(lines))
    assert places(copy) == [JOURNAL_FILE]


def test_a_journal_that_is_cut_or_damaged_is_named_and_not_repaired(copy):
    content = (copy / JOURNAL_FILE).read_bytes()
    for damaged in (content[:-9], content[:300] + b"x" + content[301:]):
        (copy / JOURNAL_FILE).write_bytes(damaged)
        assert set(places(copy)) == {JOURNAL_FILE}
        assert (copy / JOURNAL_FILE).read_bytes() == damaged


def test_what_is_no_run_is_said(tmp_path):
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun" / "journal.jsonl").touch()
    with pytest.raises(RunDirectoryError, match=r"unfinished run: .* --resume"):
        verify_run(tmp_path / "begun", Here())
    with pytest.raises(RunDirectoryError, match="is no run"):
        verify_run(tmp_path, Here())
