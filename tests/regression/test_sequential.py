from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.records import Outcome
from minitouch_bench.regression.comparison import ComparedRun
from minitouch_bench.regression.gate import Decision, judge_runs
from minitouch_bench.regression.sequential import (
    SequentialGate,
    early_result,
    final_result,
    play_order,
)
from minitouch_bench.regression.settings import GateSettings, Tolerance
from minitouch_bench.regression.tables import episodes_line
from tests.regression.pairs import draw, flags, make_saved, values

N = 100
ROOT = (0,)
SUCCESS = GateSettings(metrics=("success",))
BASELINE = make_saved({"pushing": values(flags(95, N)), "opening": values(flags(90, N))}, "base")


def make_gate(settings=SUCCESS, baseline=BASELINE):
    return SequentialGate(play_order(baseline.episodes, ROOT), settings, ROOT)


def played(candidate, settings=SUCCESS, baseline=BASELINE):
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
    assert "worse beyond its tolerance" in gate.reason


def test_what_the_last_episodes_cannot_change_is_certain_and_is_what_the_whole_run_gives():
    lost = flags(0, N) | (np.arange(N) % 2 == 0)
    gate = played(candidate(lost & flags(95, N), flags(90, N)))
    assert gate.decision is Decision.REGRESSION
    whole = candidate(lost & flags(95, N), flags(90, N))
    level = replace(SUCCESS, alpha=gate.alpha.final)
    assert judge_runs(BASELINE, whole, ("a", "b"), level).decision is Decision.REGRESSION


def test_a_better_policy_passes_before_the_end():
    gate = played(
        candidate(flags(N, N), flags(N, N)),
        replace(SUCCESS, tolerances={"success": Tolerance(0.1)}),
    )
    assert gate.decision is Decision.PASSED
    assert gate.used < 2 * N
    assert gate.reason == "every metric is within its tolerance"


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
        assert gate.judged() == wanted.judged()
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


def test_the_early_result_shows_what_was_seen_with_intervals_that_hold():
    other = candidate(flags(0, N), flags(90, N))
    settings = GateSettings()
    gate = played(other, settings)
    run = ComparedRun("candidate", "a name", "runs/new one")
    result = early_result(gate, BASELINE, "runs/base", run, other.header)
    assert (result.decision, result.exit_code) == (Decision.REGRESSION, 1)
    assert result.episodes_used.used == gate.used < result.episodes_used.planned == 2 * N
    assert "% saved" in episodes_line(result)
    assert result.next_command.endswith("--output 'runs/new one' --resume")
    for one in result.judged:
        difference = one.effect.difference
        assert difference.low <= difference.value <= difference.high
        wanted = "betting" if one.effect.metric == "success" else "bootstrap-t"
        assert difference.method.startswith(wanted)
        assert one.effect.count <= gate.used
    by_metric = {(one.effect.task, one.effect.metric): one for one in result.judged}
    lost = by_metric["pushing", "success"].effect.difference
    assert lost.high < 0
    assert len(result.changes) == by_metric["pushing", "success"].effect.differing


def test_a_whole_run_is_judged_at_what_is_left_of_the_level():
    # 9 lost and 0 won: p = 0.0039, 0.0117 after Holm over two tasks and their mean.
    other = candidate(flags(86, N), flags(90, N))
    for alpha, decision in ((0.0353, Decision.REGRESSION), (0.035, Decision.INCONCLUSIVE)):
        settings = replace(SUCCESS, alpha=alpha)
        result = final_result(BASELINE, other, ("a", "b"), settings)
        assert result.decision is decision
        assert result.settings == settings
        assert episodes_line(result).startswith("200 of 200 episodes were played")


def test_means_alone_are_guarded_too():
    rng = np.random.default_rng(0)
    hard = rng.random(N)
    base = make_saved({"playing": draw(rng, 0.5, hard)}, "base")
    touch = base.episodes[0].touch_interaction
    assert touch > 0
    halved = replace(
        base,
        episodes=tuple(
            replace(one, touch_interaction=one.touch_interaction // 2) for one in base.episodes
        ),
    )
    gate = played(halved, GateSettings(), base)
    assert gate.decision is Decision.REGRESSION
    assert gate.used < N / 2
    assert played(replace(base, name="again"), GateSettings(), base).decision is Decision.PASSED
