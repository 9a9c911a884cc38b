from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.episode import EpisodeSpec, Outcome, PlayedEpisode, Role, Start, Trace
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.summary import EPISODE_COLUMNS, episode_row, measure, summarize
from tests.reporting.synthetic import make_run, measured, rows_of, summary_of, with_fault

SPEC = EpisodeSpec(Role.FINAL, "pushing", 3, 42, 0, "mug-017")
START = Start((0.5, 0.1, 0.0), 1.5, (0.6, 0.1), (0.4, 0.0, 0.02))


def make_trace() -> Trace:
    touch = np.zeros((4, 11), np.float32)
    touch[:, 5] = [0, 2, 0, 2]  # variance 1 in one of six components; steps 0 and 2 feel 2 N
    touch[:, 0] = [9, 0, 9, 0]  # a position, not a force
    state = np.zeros((4, 3))
    state[:, 0] = [0, 1, 0, 1]  # variance 0.25
    state[:, 2] = [0, 2, 0, 2]  # variance 1
    return Trace(
        actions=np.zeros((3, 4), np.float32),
        clipped=np.array([True, False, True]),
        rewards=np.array([0, 0, 25], np.float32),
        ticks=np.array([20, 100, 60], np.int16),
        contact_ticks=np.array([0, 30, 12], np.int16),
        onsets=np.array([0, 2, 1], np.int16),
        touch=touch,
        object_state=state,
        first_touch_tick=36,
    )


def test_every_metric_follows_its_definition():
    found = measure(PlayedEpisode(SPEC, Outcome.SUCCESS, START, make_trace()))
    assert (found.task, found.index, found.seed, found.shape) == ("pushing", 3, 42, "mug-017")
    assert (found.outcome, found.success, found.start) == (Outcome.SUCCESS, True, START)
    assert (found.steps, found.ticks) == (3, 180)
    assert (found.episode_return, found.clipped_actions) == (25, 2)
    assert (found.touch_interaction, found.touch_onsets, found.touch_steps) == (42, 3, 2)
    assert found.touch_variance == pytest.approx(1 / 6)
    assert found.object_movement == pytest.approx(1.25)
    assert found.first_touch_tick == 36
    assert METRICS["time_to_first_touch"].value(found) == 0.15
    assert METRICS["arm_time"].value(found) == 0.75
    assert (found.peak_force, found.contact_force) == (2, 1)  # steps 1 and 2 touch


def test_forces_are_those_of_the_harder_finger_while_it_touches():
    trace = make_trace()
    trace.touch[2, 5:] = [3, 4, 0, 0, 0, 1]  # 5 N and 1 N
    trace.touch[3, 5:] = [0, 0, 0, 2, 3, 6]  # 0 N and 7 N
    metrics = measure(PlayedEpisode(SPEC, Outcome.SUCCESS, START, trace))
    assert (metrics.peak_force, metrics.contact_force) == (7, 6)
    untouched = replace(trace, contact_ticks=np.zeros(3, np.int16))
    metrics = measure(PlayedEpisode(SPEC, Outcome.SUCCESS, START, untouched))
    assert (metrics.peak_force, metrics.contact_force) == (None, None)


def test_an_episode_without_steps_has_zeros():
    record = PlayedEpisode(SPEC, Outcome.STEP_LIMIT, START, make_trace())
    metrics = measure(with_fault(record, "raised"))
    assert metrics.first_touch_tick is None
    assert METRICS["time_to_first_touch"].value(metrics) is None
    assert (metrics.steps, metrics.episode_return, metrics.touch_interaction) == (0, 0, 0)
    assert (metrics.touch_variance, metrics.object_movement, metrics.ticks) == (0, 0, 0)


def test_long_contact_of_a_door_does_not_overflow_int16():
    steps = 2000
    ticks, touch = np.full(steps, 100, np.int16), np.zeros((steps + 1, 11), np.float32)
    angles = np.array([[0.0], [0.4], [0.0], [0.4]])
    trace = replace(
        make_trace(), contact_ticks=ticks, ticks=ticks, touch=touch, object_state=angles
    )
    metrics = measure(PlayedEpisode(SPEC, Outcome.STEP_LIMIT, START, trace))
    assert metrics.touch_interaction == metrics.ticks == 200_000
    assert metrics.object_movement == pytest.approx(0.04)


def by_task(run, seed: int = 3):
    return {task.task: task for task in summary_of(run, seed).tasks}


def test_other_tasks_do_not_change_an_estimate():
    run = make_run(episodes=8)
    episodes = (rows_of(run), rows_of(run, Role.EXPLORATION), 3)
    (alone,) = summarize(("opening",), *episodes).tasks
    assert alone in summarize(run.plan.tasks, *episodes).tasks


def test_a_goal_task_has_every_metric_and_playing_those_of_touch():
    tasks = by_task(make_run(episodes=20, skill=0.7))
    pushing, playing = tasks["pushing"], tasks["playing"]
    of_a_goal = {"success", "exploration", "episode_steps", "steps_to_success"}
    assert set(pushing.estimates) - set(playing.estimates) == of_a_goal
    assert set(pushing.estimates) == set(METRICS)
    methods = [pushing.estimates[name].method for name in ("success", "touched", "episode_steps")]
    assert methods == ["wilson", "wilson", "bootstrap"]
    assert sum(pushing.outcomes.values()) == 20


def test_exploration_counts_its_own_episodes_only():
    run = make_run(episodes=10, skill=1.0)
    pushing = by_task(run)["pushing"]
    wins = sum(e.success for e in rows_of(run, Role.EXPLORATION) if e.task == "pushing")
    assert pushing.estimates["exploration"].value == wins / 10
    assert pushing.estimates["success"].value == 1.0
    assert sum(pushing.outcomes.values()) == 10


def test_steps_to_success_is_absent_without_success():
    pushing = by_task(make_run(episodes=5, skill=0.0))["pushing"]
    assert "steps_to_success" not in pushing.estimates
    assert pushing.estimates["success"].value == 0 < pushing.estimates["success"].high


def test_faults_stay_in_the_denominator():
    run = make_run(tasks=("pushing",), episodes=10, skill=1.0, faults=4)
    pushing = by_task(run)["pushing"]
    assert (pushing.estimates["success"].value, pushing.outcomes["policy_fault"]) == (0.6, 4)


def test_curves_are_over_those_that_got_there():
    run = make_run(tasks=("pushing",), episodes=6, exploration=False)
    (pushing,) = measured(run).summary.tasks
    traces = [record.trace for record in run.records]
    lengths = [len(trace.actions) for trace in traces]
    step = min(lengths)
    reached = [trace for trace in traces if len(trace.actions) > step]
    ticks = [trace.contact_ticks[step] for trace in reached]
    forces = [np.linalg.norm(trace.touch[step + 1, 5:].reshape(2, 3), axis=1) for trace in reached]
    assert pushing.touch_curve[step] == pytest.approx(np.mean(ticks))
    assert pushing.force_curve[step].median == pytest.approx(np.median(np.max(forces, 1)), abs=1e-3)
    assert pushing.curve_episodes[step] == len(reached)
    for curve in (pushing.touch_curve, pushing.force_curve, pushing.curve_episodes):
        assert len(curve) == max(lengths)


def test_touch_share_counts_steps_and_is_zero_without_any():
    run = make_run(tasks=("playing",), episodes=4)
    share = [np.mean(record.trace.contact_ticks > 0) for record in run.records]
    playing = by_task(run)["playing"].estimates["touch_share"]
    assert playing.value == pytest.approx(np.mean(share))
    failed = replace(run, records=tuple(with_fault(r, "no") for r in run.records))
    assert by_task(failed)["playing"].estimates["touch_share"].value == 0


@pytest.mark.parametrize("task", ["playing", "pushing"])
def test_a_fault_improves_nothing(task):
    record = PlayedEpisode(
        replace(SPEC, task=task), Outcome.POLICY_FAULT, START, make_trace(), "NaN"
    )
    for outcome, steps in ((Outcome.POLICY_FAULT, 200), (Outcome.STEP_LIMIT, 3)):
        row = measure(replace(record, outcome=outcome))
        assert METRICS["episode_steps"].value(row) == steps
        cells = dict(zip(EPISODE_COLUMNS, episode_row(row), strict=True))
        assert cells["steps"] == row.steps == 3
        assert METRICS["touch_share"].value(row) == cells["touch_share"] == 2 / steps
