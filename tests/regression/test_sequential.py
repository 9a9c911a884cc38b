from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.records import Outcome
from minitouch_bench.regression.gate import Decision, judge_runs
from minitouch_bench.regression.sequential import SequentialGate, play_order
from minitouch_bench.regression.settings import GateSettings, Tolerance
from minitouch_bench.regression.tables import episodes_line
from tests.regression.pairs import draw, flags, make_saved, values

N = 100
ROOT = (0,)
STANDARD = GateSettings()
BASELINE = make_saved({"pushing": values(flags(95, N)), "opening": values(flags(90, N))}, "base")


def make_gate(settings=STANDARD, baseline=BASELINE):
    return SequentialGate(baseline, settings)


def played(candidate, settings=STANDARD, baseline=BASELINE):
    gate = make_gate(settings, baseline)
    gate.add(candidate.episodes)
    return gate


def candidate(pushing, opening):
    tasks = {"pushing": values(pushing), "opening": values(opening)}
    return make_saved(tasks, "candidate")


def test_tasks_take_turns_and_each_task_is_shuffled():
    order = play_order(BASELINE.episodes, ROOT)
    assert sorted(order, key=BASELINE.episodes.index) == list(BASELINE.episodes)
    assert all(one.task != other.task for one, other in pairwise(order))
    pushing = [one.index for one in order if one.task == "pushing"]
    assert pushing != sorted(pushing)
    assert order == play_order(BASELINE.episodes, ROOT)
    assert order != play_order(BASELINE.episodes, (1,))


def test_tasks_of_unequal_length_are_all_played():
    few = BASELINE.episodes[:N] + BASELINE.episodes[N : N + 3]
    order = play_order(few, ROOT)
    assert len(order) == N + 3
    assert {one.task for one in order[6:]} == {"pushing"}


def test_a_policy_that_always_fails_is_stopped_after_a_few_episodes():
    gate = played(candidate(flags(0, N), flags(0, N)))
    assert gate.decision is Decision.REGRESSION
    assert gate.used < 2 * N / 5


@pytest.mark.parametrize("skill", [0.5, 0.85, 0.92, 1.0])
@pytest.mark.parametrize("tolerance", [0.0, 0.05, 0.2])
def test_an_early_answer_is_that_of_the_whole_run(skill, tolerance):
    rng = np.random.default_rng(7)
    settings = GateSettings(tolerance=Tolerance(tolerance))
    for _ in range(10):
        other = candidate(rng.random(N) < skill, rng.random(N) < skill)
        gate = played(other, settings)
        whole = judge_runs(BASELINE, other, ("a", "b"), settings).decision
        assert gate.decision is whole or gate.decision is None
        if gate.decision is None:
            assert gate.used == gate.planned
            assert whole is Decision.NOT_ENOUGH


def test_a_better_policy_passes_before_the_end():
    gate = played(candidate(flags(N, N), flags(N, N)), GateSettings(tolerance=Tolerance(0.2)))
    assert gate.decision is Decision.NO_REGRESSION
    assert gate.used < 2 * N


def test_where_there_is_nothing_to_lose_one_episode_is_enough():
    base = make_saved({"pushing": values(flags(0, N))}, "base")
    gate = played(replace(base, name="again"), baseline=base)
    assert (gate.decision, gate.used) == (Decision.NO_REGRESSION, 1)


def test_episodes_count_in_one_order_whatever_the_order_they_end_in():
    rng = np.random.default_rng(3)
    other = candidate(rng.random(N) < 0.5, rng.random(N) < 0.9)
    wanted = played(other)
    for seed in range(5):
        gate = make_gate()
        turns = np.random.default_rng(seed).permutation(2 * N)
        certain = [gate.add([other.episodes[place]]) for place in turns]
        assert gate.decision is wanted.decision is Decision.REGRESSION
        assert gate.used == wanted.used
        assert gate.pairs == wanted.pairs
        assert certain == sorted(certain)


def test_the_answer_is_open_until_the_next_episode_in_order_is_there():
    gate = make_gate()
    order = play_order(BASELINE.episodes, ROOT)
    failed = [replace(one, outcome=Outcome.STEP_LIMIT) for one in order]
    assert not gate.add(failed[1:])
    assert gate.used == 0
    assert gate.add(failed[:1])


def test_another_episode_is_refused():
    with pytest.raises(UsageError, match="not the same one"):
        make_gate().add([replace(one, seed=5) for one in BASELINE.episodes])


def test_the_early_result_shows_what_was_seen():
    other = candidate(flags(0, N), flags(90, N))
    gate = played(other)
    result = gate.result("runs/base", "runs/new one", other.header, 3.5)
    assert (result.decision, result.exit_code) == (Decision.REGRESSION, 1)
    assert result.episodes_used.used == gate.used < result.episodes_used.planned == 2 * N
    assert "% saved" in episodes_line(result)
    assert result.next_command.endswith("--output 'runs/new one' --resume")
    assert result.endpoint.effect.count == gate.used
    assert result.endpoint.p_value <= result.settings.alpha
    assert ("pushing", "success") in {
        (one.effect.task, one.effect.metric) for one in result.per_task if one.is_worse
    }
    assert len(result.changes) == result.endpoint.effect.differing


def test_a_mean_is_played_to_the_end():
    hard = np.random.default_rng(0).random(N)
    base = make_saved({"playing": draw(np.random.default_rng(1), 0.5, hard)}, "base")
    still = tuple(replace(one, touch_steps=0, touch_interaction=0) for one in base.episodes)
    gate = played(replace(base, episodes=still), baseline=base)
    assert (gate.decision, gate.used) == (None, N)
