"""Seeds of fresh episodes, and the test for a drop."""

from types import SimpleNamespace

import numpy as np
import pytest

from minitouch_bench.episode import Outcome, Role
from minitouch_bench.leaderboard import fresh
from minitouch_bench.leaderboard.fresh import FRESH_EPISODES, SIGNIFICANCE, drop_p, fresh_plan

GOALS = ("pushing", "opening", "pick-up")


def test_the_seed_follows_from_checkpoint_and_draw_alone():
    plan = fresh_plan("table4", "ab" * 32, "phrase")
    assert plan == fresh_plan("table4", "ab" * 32, "phrase")
    assert plan.episodes == FRESH_EPISODES
    assert 2**200 < plan.seed < 2**256
    others = (("ab" * 32, "phrases"), ("ac" * 32, "phrase"))
    assert plan.seed not in {fresh_plan("table4", *words).seed for words in others}


def test_fresh_novel_shapes_are_drawn_half_of_them_held_out():
    plans = [fresh_plan("novel-shapes", "ab" * 32, draw) for draw in ("one", "two")]
    for plan in plans:
        specs = plan.specs()
        assert [spec.task for spec in specs].count("pick-up") == FRESH_EPISODES
        assert [spec.split for spec in specs].count("held-out") == len(specs) / 2
        assert len({spec.shape for spec in specs if spec.task == "pick-up"}) == FRESH_EPISODES
    first, second = ({spec.shape for spec in plan.specs()} for plan in plans)
    assert len(first & second) < len(first) / 2


def row(task, value):
    """What the two ranking metrics read of an episode."""
    steps = round(200 * value)
    return SimpleNamespace(
        task=task, success=bool(value), outcome=Outcome.STEP_LIMIT, touch_steps=steps, steps=200
    )


def run(values, explored=None):
    """A run whose episodes have these values, by task."""
    rows = {
        role: [row(task, value) for task, listed in (given or {}).items() for value in listed]
        for role, given in ((Role.FINAL, values), (Role.EXPLORATION, explored))
    }
    return SimpleNamespace(
        tasks=(*values,), by_role=rows.items, exploration_rows=rows[Role.EXPLORATION]
    )


def of(successes, number):
    return [1.0] * successes + [0.0] * (number - successes)


def drop(official, fresh_ones, suite="table4"):
    return drop_p({suite: official}, {suite: fresh_ones})


def test_a_table_of_stored_actions_drops_beyond_doubt_although_the_other_tasks_are_honest():
    honest = dict.fromkeys(GOALS[1:], of(50, 100))
    same = dict.fromkeys(GOALS[1:], of(25, 50))
    p = drop([run({"pushing": of(100, 100), **honest})], [run({"pushing": of(5, 50), **same})])
    assert p < 1e-9
    perfect, useless = run({"pushing": of(50, 50)}), run({"pushing": of(0, 50)})
    assert drop([perfect] * 5, [perfect] * 5) == 1.0  # trainings without any variation
    assert drop([perfect] * 5, [useless] * 5) < 1e-20
    final, explored = {"pushing": of(60, 100)}, {"pushing": of(40, 100)}
    later = run({"pushing": of(30, 50)}, {"pushing": of(0, 50)})
    assert drop([run(final, explored)], [later]) < SIGNIFICANCE


@pytest.mark.parametrize("trainings", [1, 2])
def test_tasks_that_cannot_drop_do_not_hide_one_that_does(trainings):
    """All ten other tasks and suites are at 0, which no fresh episode is worse than."""
    tasks = [f"task {number}" for number in range(10)]
    useless = {task: of(0, 100) for task in tasks}
    stored = [run({"pushing": of(99 - n, 100), **useless}) for n in range(trainings)]
    later = [run({"pushing": of(30, 50), **useless})] * trainings
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fresh, "ranking_metric", lambda task: "success")
        patch.setattr(fresh, "ORDERS", 20_000)
        assert drop(stored, later) < SIGNIFICANCE
        assert drop(stored[:1], [run({"pushing": of(48, 50), **useless})]) > SIGNIFICANCE


def test_a_few_stored_episodes_of_playing_are_seen_in_the_mean_that_ranks():
    """A quarter of the official episodes is stored; the rank of most says nothing of them."""
    rng = np.random.default_rng(0)
    honest = (np.minimum(rng.geometric(0.1, 125), 200) / 200).tolist()
    official = [run({"playing": [0.99] * 25 + honest[:75]})]
    assert drop(official, [run({"playing": honest[75:]})]) < SIGNIFICANCE


def test_a_small_drop_in_every_task_is_seen_where_no_single_one_is():
    one = drop([run({"pushing": of(100, 100)})], [run({"pushing": of(46, 50)})])
    assert one > SIGNIFICANCE
    official, fewer = (dict.fromkeys(GOALS, values) for values in (of(100, 100), of(46, 50)))
    assert drop([run(official)], [run(fewer)]) < 0.001


def test_a_small_drop_in_every_training_is_seen():
    rng = np.random.default_rng(0)
    play = lambda rate, number: (rng.random(number) < rate).astype(float).tolist()  # noqa: E731
    pairs = [(run({"pushing": play(0.9, 100)}), run({"pushing": play(0.8, 50)})) for _ in range(20)]
    official, later = zip(*pairs, strict=True)
    assert drop(official, later) < SIGNIFICANCE
    assert drop(official[:1], later[:1]) > SIGNIFICANCE


@pytest.mark.parametrize(("rate", "number"), [(0.02, 2), (0.5, 5), (0.99, 5)])
def test_honest_rows_on_the_same_scenes_hardly_ever_lose_their_rank(monkeypatch, rate, number):
    """Three tasks, two policies; half of an official episode's variance is that of its scene."""
    monkeypatch.setattr(fresh, "ORDERS", 1000)
    rng = np.random.default_rng(0)

    def play(episodes, scenes):
        own = rng.random((2, 3, episodes)) < rate
        same = rng.random((2, 3, episodes)) < 0.5
        found = np.where(same, scenes, own) if scenes is not None else own
        final, explored = (
            dict(zip(GOALS, one.astype(float).tolist(), strict=True)) for one in found
        )
        return run(final, explored)

    def p():
        scenes = rng.random((1, 3, 100)) < rate
        official = [play(100, scenes) for _ in range(number)]
        return drop(official, [play(50, None) for _ in range(number)])

    lost = sum(p() < SIGNIFICANCE for _ in range(100))
    assert lost <= 4  # more are seen once in five thousand times
