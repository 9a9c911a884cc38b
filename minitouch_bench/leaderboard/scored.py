"""What a board of a thousand keeps of each submission, from one build to the next."""

from collections.abc import Mapping
from dataclasses import dataclass

from minitouch_bench.leaderboard.failures import Ending
from minitouch_bench.leaderboard.proof import FreshProof, ProofLevel
from minitouch_bench.leaderboard.submission import Submission
from minitouch_bench.policies.loading import BUILT_IN
from minitouch_bench.records import Estimate, Gap


@dataclass(frozen=True)
class ScoredSubmission:
    """All that a board shows of one submission and that no other one changes, as plain JSON.

    ``runs``: the digest of each run by its path. ``figures`` by task or "overall", then by
    metric; ``gaps`` by task; ``endings``: number of episodes by task and ending. ``values`` by
    task: of each training seed, the episodes' values in the metric that ranks the task.
    ``videos`` are paths in the submission. ``page`` is its page, with marks where the ranks
    stand. ``sketches``: see ``twins.sketch_of``; only a proof has them.
    """

    about: Submission
    level: ProofLevel
    rerun_episodes: int
    fresh: FreshProof | None
    sketches: Mapping[str, tuple[float, ...]]
    runs: Mapping[str, str]
    figures: Mapping[str, Mapping[str, Estimate]]
    gaps: Mapping[str, Gap]
    endings: Mapping[str, Mapping[Ending, int]]
    values: Mapping[str, tuple[tuple[float, ...], ...]]
    videos: tuple[str, ...]
    page: str = ""

    @property
    def name(self) -> str:
        """The submission's name."""
        return self.about.name

    @property
    def is_calibration(self) -> bool:
        """Whether it is one of the built-in policies, which are shown and never ranked."""
        return self.name in BUILT_IN

    def estimate(self, task: str, metric: str) -> Estimate | None:
        """Return an estimate, None where there is none."""
        return self.figures.get(task, {}).get(metric)


@dataclass(frozen=True)
class Refusal:
    """A submission that is not on the board, with every reason."""

    name: str
    reasons: tuple[str, ...]
    is_other_protocol: bool
