from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.metrics import METRICS
from minitouch_bench.metrics.summary import measure
from minitouch_bench.records import EpisodeRecord, EpisodeSpec, EpisodeTrace, Outcome, Role

SPEC = EpisodeSpec(Role.FINAL, "pushing", 3, 42, "mug-017")


def make_trace() -> EpisodeTrace:
    touch = np.zeros((4, 11), np.float32)
    touch[:, 5] = [0, 2, 0, 2]  # variance 1 in one of six components
    touch[:, 0] = [9, 0, 9, 0]  # a position, not a force
    state = np.zeros((4, 3))
    state[:, 0] = [0, 1, 0, 1]  # variance 0.25
    state[:, 2] = [0, 2, 0, 2]  # variance 1
    return EpisodeTrace(
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
    metrics = measure(EpisodeRecord(SPEC, Outcome.SUCCESS, make_trace()))
    assert (metrics.task, metrics.index, metrics.seed, metrics.shape) == (
        "pushing",
        3,
        42,
        "mug-017",
    )
    assert metrics.success
    assert metrics.outcome is Outcome.SUCCESS
    assert metrics.steps == 3
    assert metrics.episode_return == 25
    assert metrics.touch_interaction == 42
    assert metrics.touch_onsets == 3
    assert metrics.touch_steps == 2
    assert metrics.touch_variance == pytest.approx(1 / 6)
    assert metrics.object_movement == pytest.approx(1.25)
    assert metrics.first_touch_tick == 36
    assert METRICS["time_to_first_touch"].value(metrics) == 0.15
    assert metrics.ticks == 180
    assert METRICS["arm_time"].value(metrics) == 0.75
    assert metrics.clipped_actions == 2


def test_a_door_moves_in_its_one_angle():
    trace = replace(make_trace(), object_state=np.array([[0.0], [0.4], [0.0], [0.4]]))
    assert measure(EpisodeRecord(SPEC, Outcome.STEP_LIMIT, trace)).object_movement == pytest.approx(
        0.04
    )


@pytest.mark.parametrize(
    "outcome", [Outcome.LEFT_WORKSPACE, Outcome.STEP_LIMIT, Outcome.POLICY_FAULT]
)
def test_only_success_is_success(outcome):
    assert not measure(EpisodeRecord(SPEC, outcome, make_trace())).success


def test_touch_at_the_very_first_tick_is_touch():
    trace = replace(make_trace(), first_touch_tick=0)
    assert measure(EpisodeRecord(SPEC, Outcome.SUCCESS, trace)).first_touch_tick == 0


@pytest.mark.parametrize("samples", [0, 1])
def test_an_episode_without_steps_has_zeros(samples):
    nothing = np.zeros(0, np.int16)
    trace = EpisodeTrace(
        actions=np.zeros((0, 4), np.float32),
        clipped=np.zeros(0, bool),
        rewards=np.zeros(0, np.float32),
        ticks=nothing,
        contact_ticks=nothing,
        onsets=nothing,
        touch=np.ones((samples, 11), np.float32),
        object_state=np.ones((samples, 3)),
    )
    metrics = measure(EpisodeRecord(SPEC, Outcome.POLICY_FAULT, trace, "raised"))
    assert metrics.first_touch_tick is None
    assert METRICS["time_to_first_touch"].value(metrics) is None
    assert (metrics.steps, metrics.episode_return, metrics.touch_interaction) == (0, 0, 0)
    assert (metrics.touch_variance, metrics.object_movement, metrics.ticks) == (0, 0, 0)


def test_long_contact_does_not_overflow_int16():
    steps = 2000
    trace = replace(
        make_trace(),
        contact_ticks=np.full(steps, 100, np.int16),
        ticks=np.full(steps, 100, np.int16),
    )
    metrics = measure(EpisodeRecord(SPEC, Outcome.STEP_LIMIT, trace))
    assert metrics.touch_interaction == 200_000
    assert metrics.ticks == 200_000
