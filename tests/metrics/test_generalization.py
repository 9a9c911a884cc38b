from dataclasses import replace

import pytest

from minitouch_bench.episode import Outcome, Role
from minitouch_bench.metrics.summary import MIN_EPISODES, generalize
from tests.reporting.synthetic import SHAPE_TASKS, make_run, rows_of, summary_of, with_shapes

ROOT = (1, 2, 3, 4)


def novel_run(episodes: int = 40, tasks=SHAPE_TASKS):
    return with_shapes(make_run(tasks=tasks, episodes=episodes, skill=0.7, exploration=False))


def of_task(run, task):
    found = summary_of(run, 3).generalization
    return next(result for result in found if result.task == task)


def test_a_gap_is_held_out_minus_train():
    run = novel_run()
    for metric, gap in of_task(run, "pushing").gaps.items():
        assert gap.difference.value == pytest.approx(gap.held_out.value - gap.train.value)
        assert gap.difference.low < gap.difference.value < gap.difference.high
        assert (gap.held_out.count, gap.train.count, gap.difference.count) == (20, 20, 40)
        assert gap.difference.method == ("newcombe" if metric == "success" else "bootstrap")


def test_families_divide_the_episodes():
    result = of_task(novel_run(), "pick-up")
    assert sum(found.held_out.count for found in result.families.values() if found.held_out) == 20
    assert sum(found.train.count for found in result.families.values() if found.train) == 20
    assert result.families["lathed"].held_out is None
    assert result.families["lathed"].train.count == 5


def test_other_tasks_do_not_change_a_gap():
    episodes = rows_of(novel_run())
    alone = generalize([e for e in episodes if e.task == "pick-up"], ("pick-up",), ROOT)
    assert alone[0] == generalize(episodes, SHAPE_TASKS, ROOT)[-1]


def test_one_split_alone_or_a_trivial_number_of_episodes_has_no_gap():
    enough = rows_of(novel_run(2 * MIN_EPISODES, ("pushing",)))
    assert generalize(enough, ("pushing",), ROOT)
    assert not generalize(enough[:-1], ("pushing",), ROOT)
    for split in ("", "train", "held-out"):
        assert not generalize([replace(row, split=split) for row in enough], ("pushing",), ROOT)


def test_exploration_episodes_do_not_count():
    run = novel_run(tasks=("pushing",))
    twins = tuple(
        replace(r, spec=replace(r.spec, role=Role.EXPLORATION), outcome=Outcome.STEP_LIMIT)
        for r in run.records
    )
    both = replace(run, records=run.records + twins)
    assert of_task(both, "pushing") == of_task(run, "pushing")
