"""How episodes ended, by kind: what a policy fails at, not only how often."""

from collections.abc import Mapping, Sequence
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.leaderboard.entries import OUTCOMES, Episodes
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.records import Outcome


class Ending(StrEnum):
    """How an episode ended; each one has exactly one ending."""

    SUCCEEDED = "succeeded"
    TOUCHED = "touched"
    TOUCHED_FAILED = "touched, but failed"
    LEFT = "object left the workspace"
    NEVER_TOUCHED = "never touched"
    FAULT = "policy fault"


MEANINGS: Mapping[Ending, str] = {
    Ending.SUCCEEDED: "the goal was reached",
    Ending.TOUCHED: "Playing has no goal: a finger touched the object",
    Ending.TOUCHED_FAILED: "a finger touched the object, the step limit came first",
    Ending.LEFT: "a finger touched the object, which then left the workspace",
    Ending.NEVER_TOUCHED: "no finger ever touched the object",
    Ending.FAULT: "the policy raised, timed out or gave no valid action",
}

TONES: Mapping[Ending, str] = {
    Ending.SUCCEEDED: "success",
    Ending.TOUCHED: "touched",
    Ending.TOUCHED_FAILED: "failed",
    Ending.LEFT: "left",
    Ending.NEVER_TOUCHED: "limit",
    Ending.FAULT: "fault",
}
"""The colors of the endings."""

ENDINGS = tuple(Ending)


def endings(episodes: Episodes, task: str) -> NDArray[np.int8]:
    """Return the ending of each episode, as places in ENDINGS."""
    touched = Ending.TOUCHED_FAILED if task in GOAL_TASKS else Ending.TOUCHED
    found = np.where(episodes.touched, ENDINGS.index(touched), ENDINGS.index(Ending.NEVER_TOUCHED))
    left = episodes.touched & (episodes.outcome == OUTCOMES.index(Outcome.LEFT_WORKSPACE))
    found[left] = ENDINGS.index(Ending.LEFT)
    found[episodes.success] = ENDINGS.index(Ending.SUCCEEDED)
    found[episodes.outcome == OUTCOMES.index(Outcome.POLICY_FAULT)] = ENDINGS.index(Ending.FAULT)
    return found.astype(np.int8)


def count_endings(listed: Sequence[Episodes], task: str) -> dict[Ending, int]:
    """Return how many episodes of all training seeds ended in each way that occurs."""
    counts = sum(
        (np.bincount(endings(one, task), minlength=len(ENDINGS)) for one in listed),
        np.zeros(len(ENDINGS), int),
    )
    return {ending: int(n) for ending, n in zip(ENDINGS, counts, strict=True) if n}
