"""How episodes ended: the one ending of each, and its color."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.records import EpisodeMetrics, Outcome


class Ending(StrEnum):
    """How an episode ended; each one has exactly one ending."""

    SUCCEEDED = "succeeded"
    TOUCHED = "touched"
    TOUCHED_FAILED = "touched, but failed"
    LEFT = "object left the workspace"
    NEVER_TOUCHED = "never touched"
    FAULT = "policy fault"


@dataclass(frozen=True)
class EndingStyle:
    """The color of an ending, and what it means."""

    tone: str
    meaning: str


ENDINGS: Mapping[Ending, EndingStyle] = MappingProxyType(
    {
        Ending.SUCCEEDED: EndingStyle("success", "the goal was reached"),
        Ending.TOUCHED: EndingStyle("touched", "Playing has no goal: a finger touched the object"),
        Ending.TOUCHED_FAILED: EndingStyle(
            "failed", "a finger touched the object, the step limit came first"
        ),
        Ending.LEFT: EndingStyle(
            "left", "a finger touched the object, which then left the workspace"
        ),
        Ending.NEVER_TOUCHED: EndingStyle("limit", "no finger ever touched the object"),
        Ending.FAULT: EndingStyle("fault", "the policy raised, timed out or gave no valid action"),
    }
)
"""The endings in the order of every table."""


def ending_of(episode: EpisodeMetrics) -> Ending:
    """Return how an episode ended."""
    if episode.outcome is Outcome.POLICY_FAULT:
        return Ending.FAULT
    if episode.success:
        return Ending.SUCCEEDED
    if not episode.touch_interaction:
        return Ending.NEVER_TOUCHED
    if episode.outcome is Outcome.LEFT_WORKSPACE:
        return Ending.LEFT
    return Ending.TOUCHED_FAILED if episode.task in GOAL_TASKS else Ending.TOUCHED


def count_endings(episodes: Iterable[EpisodeMetrics]) -> dict[Ending, int]:
    """Return how many episodes ended in each way that occurs."""
    counts = Counter(map(ending_of, episodes))
    return {ending: counts[ending] for ending in ENDINGS if counts[ending]}
