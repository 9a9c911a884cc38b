import math
from dataclasses import replace

import pytest

from minitouch_bench.episode import Episode, Outcome
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.verification.static_check import contradictions

MAX_TICKS, RATE = PROTOCOL.control.max_ticks, PROTOCOL.physics.tick_rate
LONGEST = PROTOCOL.task("pushing").max_steps

FAILED = Episode(
    task="pushing", index=0, seed=1, shape="cube", family="", split="",
    outcome=Outcome.LEFT_WORKSPACE, steps=20, episode_return=0.0, touch_interaction=0,
    touch_onsets=0, touch_steps=0, touch_variance=0.0, object_movement=0.0, first_touch_tick=None,
    ticks=2000, clipped_actions=0, digest="0" * 64,
)  # fmt: skip


@pytest.mark.parametrize("steps", [1, 2, 60, LONGEST - 1, LONGEST])
def test_an_honest_episode_of_any_length_passes_at_both_ends(steps):
    outcome = Outcome.STEP_LIMIT if steps == LONGEST else Outcome.LEFT_WORKSPACE
    for ticks in (steps, steps * MAX_TICKS):
        honest = replace(FAILED, outcome=outcome, steps=steps, ticks=ticks)
        touched = {"touch_interaction": ticks, "touch_steps": steps, "touch_onsets": 1}
        touching = replace(honest, **touched, first_touch_tick=ticks - 1)
        assert not list(contradictions(honest))
        assert not list(contradictions(touching))
        assert METRICS["arm_time"].value(honest) * RATE == pytest.approx(ticks)
    for ticks in (steps - 1, steps * MAX_TICKS + 1):
        dishonest = replace(FAILED, outcome=outcome, steps=steps, ticks=ticks)
        assert any("ticks" in what for what in contradictions(dishonest))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"outcome": Outcome.SUCCESS}, "episode_return is 0, not 25"),
        ({"task": "playing"}, "nothing can leave"),
        ({"task": "playing", "outcome": Outcome.SUCCESS}, "has no goal"),
        ({"outcome": Outcome.STEP_LIMIT}, "ended at the step limit after 20"),
        ({"steps": 0}, "steps is 0, not 1 to 200"),
        ({"clipped_actions": 21}, "clipped_actions is 21, not 0 to 20"),
        ({"touch_interaction": 2001}, "touch_interaction is 2001, not 0 to 2000"),
        ({"touch_interaction": 5}, "touch_steps is 0, not 1 to 5"),
        ({"touch_interaction": 5}, "first_touch_tick is None, not 0 to 1999"),
        ({"first_touch_tick": 3}, "first_touch_tick is 3, not None"),
        ({"object_movement": math.nan}, "object_movement is nan"),
    ],
)
def test_what_no_episode_can_be_is_named(change, words):
    assert any(words in what for what in contradictions(replace(FAILED, **change)))


@pytest.mark.parametrize("metric", [one for one in METRICS.values() if one.measure is not None])
def test_every_measured_metric_has_values_that_no_episode_can_have(metric):
    impossible = replace(FAILED, **{metric.measured_field: -1})
    assert f"{metric.measured_field} is -1" in "; ".join(contradictions(impossible))
