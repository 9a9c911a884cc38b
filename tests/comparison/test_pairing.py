from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.comparison.comparison import differences_of_making
from minitouch_bench.comparison.pairing import collect_values, pair_runs
from minitouch_bench.episode import Role
from minitouch_bench.errors import UsageError
from tests.comparison.pairs import flags, make_saved, values, with_header
from tests.reporting.synthetic import make_run, save

ONE = make_saved({"playing": values(flags(0, 5)), "pushing": values(flags(3, 5))}, "one")
OTHER = make_saved({"playing": values(flags(0, 5)), "pushing": values(flags(4, 5))}, "other")


def with_episode(run, place, **changes):
    episodes = list(run.rows)
    episodes[place] = replace(episodes[place], **changes)
    return replace(run, rows=tuple(episodes))


def test_runs_of_the_same_episodes_are_paired_whatever_their_order():
    pairs = pair_runs(ONE, replace(OTHER, rows=OTHER.rows[::-1]))
    assert [pair.key for pair in pairs][4:6] == ["playing/4", "pushing/0"]
    for pair in pairs:
        assert (pair.first.task, pair.first.index) == (pair.second.task, pair.second.index)


def test_a_goal_brings_its_metrics_and_playing_has_touch_alone():
    found = collect_values(pair_runs(ONE, OTHER), ("playing", "pushing"))
    assert [(values.task, values.metric) for values in found] == [
        ("playing", "touch_interaction"),
        ("playing", "touch_share"),
        ("pushing", "success"),
        ("pushing", "episode_steps"),
        ("pushing", "touch_interaction"),
        ("pushing", "touch_share"),
    ]
    np.testing.assert_array_equal(found[2].differences, [0, 0, 0, 1, 0])
    np.testing.assert_array_equal(found[3].differences, [0, 0, 0, -180, 0])


def test_several_tasks_with_a_goal_have_a_mean_over_all_their_episodes():
    goals = {"pushing": values(flags(3, 5)), "pick-up": values(flags(1, 5))}
    one, other = make_saved(goals, "one"), make_saved({**goals, "pick-up": goals["pushing"]}, "two")
    *_, mean = collect_values(pair_runs(one, other), ("playing", "pushing", "pick-up"))
    assert (mean.task, mean.metric, mean.tasks) == ("mean", "success", ("pushing", "pick-up"))
    np.testing.assert_array_equal(mean.differences, [0, 0, 0, 0, 0, 0, 1, 1, 0, 0])
    more = make_saved({**goals, "pick-up": values(flags(1, 6))})
    unequal = collect_values(pair_runs(more, more), ("pushing", "pick-up"))
    assert "mean" not in {values.task for values in unequal}


def test_exploration_episodes_are_paired_by_their_role():
    one = save(make_run("one", tasks=("pushing",), episodes=6), "one")
    other = save(make_run("other", tasks=("pushing",), episodes=6), "other")
    pairs = pair_runs(one, other)
    assert [pair.role for pair in pairs].count(Role.EXPLORATION) == 6
    assert pairs[-1].key == "exploration/pushing/5"
    found = collect_values(pairs, ("pushing",))
    assert [values.metric for values in found][:2] == ["exploration", "success"]
    with pytest.raises(UsageError, match="exploration/pushing/0"):
        pair_runs(one, replace(other, exploration_rows=()))


def test_a_task_with_other_rules_is_left_out():
    other = with_header(OTHER, task_digests={**OTHER.header.task_digests, "pushing": "ff" * 32})
    assert {pair.first.task for pair in pair_runs(ONE, other)} == {"playing"}
    assert differences_of_making(ONE, other)[0] == "pushing is left out: its rules differ"


REFUSALS = [
    (
        with_header(OTHER, task_digests=dict.fromkeys(OTHER.plan.tasks, "ff" * 32)),
        "protocols differ .*ffffffffffff",
    ),
    (with_header(OTHER, suite="smoke"), "suites differ .table4; smoke"),
    (with_header(OTHER, seed=7), "seeds differ .0; 7"),
    (
        replace(OTHER, rows=OTHER.rows[:-2]),
        "2 of the first are not in the second.*pushing/3",
    ),
    (with_episode(OTHER, 6, seed=3), "pushing/1 are not the same one: seed '1001'.*'3'"),
    (with_episode(OTHER, 6, shape="mug"), "pushing/1.*shape"),
    (with_episode(OTHER, 6, index=0), "holds the episode pushing/0 twice"),
    (replace(OTHER, rows=()), "holds no episodes"),
]


@pytest.mark.parametrize(("run", "reason"), REFUSALS)
def test_what_cannot_be_paired_is_refused_with_the_reason(run, reason):
    with pytest.raises(UsageError, match=reason):
        pair_runs(ONE, run)
    with pytest.raises(UsageError):
        pair_runs(run, ONE)


def test_a_hostile_name_cannot_fill_the_message():
    hostile = replace(with_header(OTHER, seed=7), name="\x1b[31m" + "x" * 10_000)
    with pytest.raises(UsageError) as refusal:
        pair_runs(ONE, hostile)
    assert "\x1b" not in str(refusal.value)
    assert len(str(refusal.value)) < 400
