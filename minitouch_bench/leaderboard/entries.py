"""A checked submission with its episodes: a column per metric, and how each one ended."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.leaderboard.proof import Proof, ProofLevel, find_proof, level_of
from minitouch_bench.leaderboard.submission import TrainingSeed
from minitouch_bench.leaderboard.validation import Verdict
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.metric import ShownIn
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.records import EpisodeMetrics, Outcome, Role

OUTCOMES = tuple(Outcome)
BOARD_METRICS = tuple(
    name for name, metric in METRICS.items() if metric.shown_in & {ShownIn.TABLE4, ShownIn.BOARD}
)
"""What a board estimates of every task that has it."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Episodes:
    """One task's episodes of one role in one run, a column a field, in the suite's order.

    ``outcome`` holds places in OUTCOMES; ``values`` those of the metrics that a board shows, NaN
    where an episode has none; ``held_out`` marks episodes with a held-out shape.
    """

    index: NDArray[np.int32]
    outcome: NDArray[np.int8]
    values: Mapping[str, Floats]
    held_out: NDArray[np.bool_]
    shapes: tuple[str, ...]

    @property
    def success(self) -> NDArray[np.bool_]:
        """Which episodes succeeded."""
        return np.equal(self.outcome, OUTCOMES.index(Outcome.SUCCESS))

    @property
    def touched(self) -> NDArray[np.bool_]:
        """Which episodes had any contact."""
        return np.greater(self.values["touched"], 0)


@dataclass(frozen=True)
class Entry:
    """A submission that may stand on the board, with its proof and the episodes of its runs.

    ``columns`` holds them by the run's path, their role and their task.
    """

    verdict: Verdict
    proof: Proof | None
    level: ProofLevel
    columns: Mapping[tuple[str, Role, str], Episodes]

    @property
    def seeds(self) -> tuple[TrainingSeed, ...]:
        """The training seeds."""
        return self.verdict.submission.seeds

    def all_have(self, suite: str, role: Role, task: str) -> bool:
        """Tell whether every training seed has these episodes."""
        return all((seed.runs.get(suite), role, task) in self.columns for seed in self.seeds)

    def episodes(self, suite: str, role: Role, task: str) -> tuple[Episodes, ...]:
        """Return these episodes of every training seed."""
        return tuple(self.columns[seed.runs[suite], role, task] for seed in self.seeds)

    def values(self, suite: str, role: Role, task: str, metric: str) -> tuple[Floats, ...]:
        """Return a metric's values in these episodes, of every training seed."""
        return tuple(one.values[metric] for one in self.episodes(suite, role, task))


def make_entry(verdict: Verdict) -> Entry:
    """Find the proof of a submission that passed, and put its episodes into columns."""
    rows: dict[tuple[str, Role, str], list[EpisodeMetrics]] = {}
    for place, saved in verdict.runs.items():
        for role, episodes in saved.by_role():
            for row in episodes:
                rows.setdefault((place, role, row.task), []).append(row)
    columns = {key: _columns(own) for key, own in rows.items()}
    proof = find_proof(verdict)
    return Entry(verdict, proof, level_of(verdict, proof), columns)


def _columns(rows: Sequence[EpisodeMetrics]) -> Episodes:
    places = {outcome: place for place, outcome in enumerate(OUTCOMES)}
    return Episodes(
        index=np.array([e.index for e in rows], np.int32),
        outcome=np.array([places[e.outcome] for e in rows], np.int8),
        values={
            # None becomes NaN.
            name: np.array([METRICS[name].value(e) for e in rows], np.float64)
            for name in BOARD_METRICS
        },
        held_out=np.array([e.split == "held-out" for e in rows], np.bool_),
        shapes=tuple(e.shape for e in rows),
    )


class Ending(StrEnum):
    """How an episode ended; each one has exactly one ending."""

    SUCCEEDED = "succeeded"
    TOUCHED = "touched"
    TOUCHED_FAILED = "touched, but failed"
    LEFT = "object left the workspace"
    NEVER_TOUCHED = "never touched"
    FAULT = "policy fault"


ENDING_MEANINGS: Mapping[Ending, str] = {
    Ending.SUCCEEDED: "the goal was reached",
    Ending.TOUCHED: "Playing has no goal: a finger touched the object",
    Ending.TOUCHED_FAILED: "a finger touched the object, the step limit came first",
    Ending.LEFT: "a finger touched the object, which then left the workspace",
    Ending.NEVER_TOUCHED: "no finger ever touched the object",
    Ending.FAULT: "the policy raised, timed out or gave no valid action",
}

ENDING_TONES: Mapping[Ending, str] = {
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
