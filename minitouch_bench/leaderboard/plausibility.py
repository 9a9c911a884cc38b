"""What no episode can be: figures that contradict each other or the rules of the tasks."""

from collections.abc import Iterator

from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL
from minitouch_bench.records import EpisodeMetrics, Outcome

FINGERS = 2
MAX_TICKS = PROTOCOL.control.max_ticks


def contradictions(row: EpisodeMetrics) -> Iterator[str]:
    """Yield what cannot be true of one episode, in words."""
    yield from _outcome(row)
    yield from _length(row)
    yield from _touch(row)


def _outcome(row: EpisodeMetrics) -> Iterator[str]:
    if row.outcome is Outcome.SUCCESS and row.task not in GOAL_TASKS:
        yield f"{row.task} has no goal and cannot succeed"
    if row.outcome is Outcome.LEFT_WORKSPACE and not PROTOCOL.task(row.task).object_can_leave:
        yield f"in {row.task} nothing can leave the workspace"
    reward = PROTOCOL.task(row.task).success_reward if row.success else 0.0
    if row.episode_return != reward:
        yield f"the return is {row.episode_return:g}, not {reward:g}"


def _length(row: EpisodeMetrics) -> Iterator[str]:
    longest = PROTOCOL.task(row.task).max_steps
    least = 0 if row.outcome is Outcome.POLICY_FAULT else 1
    if not least <= row.steps <= longest:
        yield f"{row.steps} steps, not {least} to {longest}"
    if row.outcome is Outcome.STEP_LIMIT and row.steps != longest:
        yield f"it ended at the step limit after {row.steps} of {longest} steps"
    if not row.steps <= row.ticks <= row.steps * MAX_TICKS:
        yield f"{row.ticks} ticks are not {row.steps} steps of 1 to {MAX_TICKS} ticks"
    if row.clipped_actions > row.steps:
        yield f"{row.clipped_actions} clipped actions in {row.steps} steps"


def _touch(row: EpisodeMetrics) -> Iterator[str]:
    if row.touch_interaction > row.ticks:
        yield f"{row.touch_interaction} ticks of contact in {row.ticks} ticks"
    if not row.touch_steps <= min(row.steps, row.touch_interaction):
        yield f"{row.touch_steps} steps with contact, {row.touch_interaction} ticks of contact"
    if row.touch_onsets > FINGERS * row.touch_interaction:
        yield f"{row.touch_onsets} contacts begun in {row.touch_interaction} ticks of contact"
    touched = row.touch_interaction > 0
    if touched != (row.touch_steps > 0) or touched != (row.touch_onsets > 0):
        yield "some of its figures of contact are 0 and others are not"
    if touched != (row.first_touch_tick is not None):
        yield f"first touch is {row.first_touch_tick}, contact {row.touch_interaction} ticks"
    elif row.first_touch_tick is not None and row.first_touch_tick >= row.ticks:
        yield f"first touch at tick {row.first_touch_tick} of {row.ticks}"
    if row.touch_variance < 0 or row.object_movement < 0:
        yield "a variance is below 0"
