"""How an episode ended, in the words and the colors of every table, chart and map."""

from enum import StrEnum
from typing import Self

from minitouch_bench.episode import Episode, Outcome
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.reporting.charts import LegendItem


class Ending(StrEnum):
    """How an episode ended; each one has exactly one ending."""

    tone: str
    meaning: str

    def __new__(cls, value: str, tone: str, meaning: str) -> Self:
        """Make an ending with its color, and what it means."""
        ending = str.__new__(cls, value)
        ending._value_, ending.tone, ending.meaning = value, tone, meaning
        return ending

    @property
    def legend(self) -> LegendItem:
        """The color of this ending, with its name."""
        return LegendItem(self.value, self.tone, title=self.meaning)

    # In the order of every table.
    SUCCEEDED = "succeeded", "success", "the goal was reached"
    TOUCHED = "touched", "touched", "Playing has no goal: a finger touched the object"
    TOUCHED_FAILED = (
        "touched, but failed", "failed", "a finger touched the object, the step limit came first",
    )  # fmt: skip
    LEFT = (
        "object left the workspace", "left",
        "a finger touched the object, which then left the workspace",
    )  # fmt: skip
    NEVER_TOUCHED = (
        "never touched by a finger", "limit",
        "no finger touched the object; the hand may have pushed it out of the workspace",
    )  # fmt: skip
    FAULT = "policy fault", "fault", "the policy raised, timed out or gave no valid action"


def ending_of(episode: Episode) -> Ending:
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
