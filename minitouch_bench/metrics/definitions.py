"""Every metric in one table: its label, unit, direction and source."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

UP = "↑"
DOWN = "↓"
NO_DIRECTION = ""


@dataclass(frozen=True)
class Metric:
    """What a metric is called, what it counts, and how it is written.

    ``direction``: UP or DOWN where more or less is better, else NO_DIRECTION. ``source``:
    T (text of the paper), R (the released package) or D (decided here). ``number_format``:
    Python format of a value.
    """

    name: str
    label: str
    unit: str
    direction: str
    source: str
    number_format: str
    meaning: str


_TABLE = (
    Metric("success", "Success", "share of episodes", UP, "T", ".3f", "episodes that succeed"),
    Metric(
        "exploration",
        "Exploration",
        "share of episodes",
        UP,
        "T",
        ".3f",
        "episodes that succeed after training on intrinsic reward alone",
    ),
    Metric(
        "episode_steps",
        "Episode steps",
        "control steps",
        DOWN,
        "T",
        ".1f",
        "length of an episode, failures included",
    ),
    Metric(
        "steps_to_success",
        "Steps to success",
        "control steps",
        DOWN,
        "D",
        ".1f",
        "length of an episode that succeeds",
    ),
    Metric(
        "touch_interaction",
        "Touch-interaction",
        "ticks",
        UP,
        "T",
        ".1f",
        "physics ticks with a finger in contact with the object",
    ),
    Metric("touch_onsets", "Touch onsets", "contacts", NO_DIRECTION, "D", ".1f", "contacts begun"),
    Metric(
        "touch_steps",
        "Touch steps",
        "control steps",
        NO_DIRECTION,
        "D",
        ".1f",
        "control steps with contact",
    ),
    Metric(
        "touch_variance",
        "Touch variance",
        "N²",
        NO_DIRECTION,
        "R",
        ".3g",
        "variance of the finger forces over the episode",
    ),
    Metric(
        "object_movement",
        "Object movement",
        "m²",
        NO_DIRECTION,
        "T",
        ".1e",
        "variance of the object's position, or of the door's angle, over the episode",
    ),
    Metric(
        "time_to_first_touch",
        "First touch",
        "s",
        NO_DIRECTION,
        "D",
        ".2f",
        "simulated time to the first contact, episodes that touched",
    ),
    Metric("arm_time", "Arm time", "s", NO_DIRECTION, "D", ".2f", "simulated time of an episode"),
    Metric("return", "Return", "reward", UP, "T", ".2f", "sum of the task's rewards"),
    Metric(
        "clipped_actions",
        "Clipped actions",
        "control steps",
        NO_DIRECTION,
        "D",
        ".1f",
        "actions beyond -1 to 1, which are clipped",
    ),
    Metric(
        "touched",
        "Touched",
        "share of episodes",
        NO_DIRECTION,
        "D",
        ".3f",
        "episodes with any contact",
    ),
)

METRICS: Mapping[str, Metric] = MappingProxyType({metric.name: metric for metric in _TABLE})
"""The metrics by name."""


def unit_of(metric: str, task: str) -> str:
    """Return the unit of a metric: Opening's object is a door, so it moves in rad²."""
    if metric == "object_movement" and task == "opening":
        return "rad²"
    return METRICS[metric].unit
