"""A checked submission that may stand on the board, and how its episodes ended."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from minitouch_bench.files import list_videos
from minitouch_bench.leaderboard.proof import Proof, ProofLevel
from minitouch_bench.leaderboard.submission import Submission
from minitouch_bench.leaderboard.validation import Verdict
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.records import EpisodeMetrics, Outcome
from minitouch_bench.runs.run import Run


@dataclass(frozen=True)
class Entry:
    """A submission that passed, with its proof."""

    verdict: Verdict
    proof: Proof | None
    level: ProofLevel

    @property
    def about(self) -> Submission:
        """What its ``submission.toml`` says."""
        return self.verdict.submission

    def runs(self, suite: str) -> tuple[Run, ...]:
        """Return the run of each training seed; none where one of them lacks the suite."""
        runs = self.verdict.runs
        places = [seed.runs.get(suite, "") for seed in self.about.seeds]
        return tuple(runs[place] for place in places) if all(places) else ()

    def episodes(self, suite: str, task: str) -> tuple[tuple[EpisodeMetrics, ...], ...]:
        """Return the final policy's episodes of a task, of each training seed, in order."""
        return tuple(
            tuple(row for row in run.episodes if row.task == task) for run in self.runs(suite)
        )

    def videos(self) -> tuple[str, ...]:
        """Return the paths of its videos inside the submission."""
        directory = self.verdict.directory
        return tuple(
            video.relative_to(directory).as_posix()
            for place in self.verdict.runs
            for video in list_videos(directory / place)
        )


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
