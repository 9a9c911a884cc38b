"""The board as data: what ``leaderboard.json`` holds, and what every other writer draws.

Its schema is published as ``docs/leaderboard.schema.json``.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from minitouch_bench.documents import schema_of
from minitouch_bench.leaderboard.copies import find_copies
from minitouch_bench.leaderboard.entries import Ending
from minitouch_bench.leaderboard.proof import RANKED_LEVELS, FreshProof, ProofLevel
from minitouch_bench.leaderboard.ranking import Rank, rank
from minitouch_bench.leaderboard.scores import OVERALL, RANKED_BY
from minitouch_bench.metrics.definitions import metrics_shown_in
from minitouch_bench.metrics.metric import ShownIn
from minitouch_bench.policies.formats import BUILT_IN
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import Count, Estimate, Gap, Sha256
from minitouch_bench.reporting.paper import PAPER_METHODS, paper_values
from minitouch_bench.reporting.run_directory import with_task_names

CEILING = "scripted"
FLOORS = tuple(name for name in BUILT_IN if name != CEILING)
CALIBRATION = (CEILING, *FLOORS)
"""The built-in policies in the order of every table."""

TOUCH_METRICS = metrics_shown_in(ShownIn.BOARD)
"""The touch diagnostics of every task."""


@dataclass(frozen=True)
class PublishedValue:
    """A value of the paper's Table 4, from other episodes and object sets; never ranked.

    Where ``is_our_unit`` is false the paper does not say what it counts: never compare it with an
    estimate of the board.
    """

    task: str
    metric: str
    value: float
    is_our_unit: bool


@dataclass(frozen=True)
class PublishedMethod:
    """A method of the paper's Table 4."""

    method: str
    values: tuple[PublishedValue, ...]


@dataclass(frozen=True)
class BoardRow:
    """A submission: what it tells, how well it is proved, and its figures.

    ``same_episodes_as`` names the submissions with a run of which at least half of the episodes
    are the same, bit for bit; ``runs`` has the digest of each run. ``ranks`` by task and "overall",
    empty for a calibration policy; ``figures`` by task (or "overall") and metric, in the units that
    ``docs/metrics.md`` gives; ``novel_shapes`` by task: the metric that ranks it on held-out and on
    train shapes, and held-out minus train. ``endings``: number of episodes by how they ended.
    """

    name: str
    method: str
    authors: tuple[str, ...]
    paper: str
    code: str
    license: str
    training_steps: Count
    modalities: tuple[str, ...]
    notes: str
    proof: ProofLevel
    rerun_episodes: Count
    fresh: FreshProof | None
    same_episodes_as: tuple[str, ...]
    training_seeds: tuple[Count, ...]
    runs: Mapping[str, Sha256]
    ranks: Mapping[str, Rank]
    figures: Mapping[str, Mapping[str, Estimate]]
    novel_shapes: Mapping[str, Gap]
    endings: Mapping[str, Mapping[Ending, Count]]

    @property
    def is_calibration(self) -> bool:
        """Whether it is one of the built-in policies, which are shown and never ranked."""
        return self.name in BUILT_IN

    @property
    def is_ranked(self) -> bool:
        """Whether it has a rank."""
        return self.proof in RANKED_LEVELS and not self.is_calibration

    @property
    def repeats(self) -> str:
        """What it repeats of others, in words; "" if nothing."""
        others = ", ".join(self.same_episodes_as)
        return f"same episodes as {others}" if others else ""

    def estimate(self, task: str, metric: str) -> Estimate | None:
        """Return an estimate, None where there is none."""
        return self.figures.get(task, {}).get(metric)


@dataclass(frozen=True)
class LeftOut:
    """A submission that is not on the board, with every reason."""

    name: str
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class Board:
    """The leaderboard of one protocol: ``ranked`` from the best down.

    ``calibration`` are the built-in policies, which are never ranked, ``missing_calibration``
    those without a submission. ``other_protocol``: submissions of another protocol; ``refused``:
    submissions that do not pass.
    """

    format: Literal["minitouch-leaderboard"]
    version: Literal[3]
    protocol: str
    protocol_digest: str
    ranked: tuple[BoardRow, ...]
    unranked: tuple[BoardRow, ...]
    calibration: tuple[BoardRow, ...]
    missing_calibration: tuple[str, ...]
    paper: tuple[PublishedMethod, ...]
    other_protocol: tuple[LeftOut, ...]
    refused: tuple[LeftOut, ...]

    @property
    def rows(self) -> tuple[BoardRow, ...]:
        """The rows of this protocol, ranked ones first."""
        return (*self.ranked, *self.unranked, *self.calibration)


def board_schema() -> dict[str, Any]:
    """Return the JSON schema of ``leaderboard.json``."""
    return with_task_names(schema_of(Board, "The MiniTouch leaderboard"))


@dataclass(frozen=True)
class ScoredSubmission:
    """A submission's row without what other submissions change, and what else a board needs.

    ``values`` by task: of each training seed, the episodes' values in the metric that ranks the
    task. ``episodes`` by the path of a main run: its ``episode_digests``. ``videos`` are paths in
    the submission. ``page`` is its page, with marks where ranks and copies stand.
    """

    row: BoardRow
    values: Mapping[str, tuple[tuple[float, ...], ...]]
    episodes: Mapping[str, tuple[str, ...]]
    videos: tuple[str, ...]
    page: str = ""


@dataclass(frozen=True)
class Refusal(LeftOut):
    """A submission that did not pass, or that was made under another protocol."""

    is_other_protocol: bool


def make_board(found: Iterable[ScoredSubmission | Refusal]) -> Board:
    """Rank the submissions of one protocol."""
    listed = list(found)
    refusals = [one for one in listed if isinstance(one, Refusal)]
    scored = sorted(
        (one for one in listed if isinstance(one, ScoredSubmission)), key=lambda one: one.row.name
    )
    ranks = iter(rank([one.values for one in scored if one.row.is_ranked]))
    same = _same_episodes(scored)
    rows = [
        replace(
            row,
            same_episodes_as=tuple(sorted(same.get(row.name, ()))),
            ranks=next(ranks) if row.is_ranked else {},
        )
        for row in (one.row for one in scored)
    ]
    calibration = {row.name: row for row in rows if row.is_calibration}
    submitted = in_order([row for row in rows if not row.is_calibration], OVERALL)
    return Board(
        format="minitouch-leaderboard",
        version=3,
        protocol=PROTOCOL.name,
        protocol_digest=PROTOCOL.digest(),
        ranked=tuple(row for row in submitted if row.is_ranked),
        unranked=tuple(row for row in submitted if not row.is_ranked),
        calibration=tuple(calibration[name] for name in CALIBRATION if name in calibration),
        missing_calibration=tuple(name for name in CALIBRATION if name not in calibration),
        paper=tuple(map(_published, PAPER_METHODS)),
        other_protocol=_left_out(one for one in refusals if one.is_other_protocol),
        refused=_left_out(one for one in refusals if not one.is_other_protocol),
    )


def in_order(rows: Sequence[BoardRow], key: str) -> list[BoardRow]:
    """Order rows by their rank in a task or OVERALL; in one rank by the metric, then the name."""

    def order(row: BoardRow) -> tuple[int, float, str]:
        best = row.ranks[key].best if row.ranks else 0
        return best, -row.figures[key][RANKED_BY[key]].value, row.name

    return sorted(rows, key=order)


def _same_episodes(scored: Iterable[ScoredSubmission]) -> dict[str, set[str]]:
    """Return by name the others with a run of the same episodes."""
    runs = {
        (one.row.name, place): digests for one in scored for place, digests in one.episodes.items()
    }
    found: dict[str, set[str]] = {}
    for (one, _), (other, _) in find_copies(runs):
        if one != other:
            found.setdefault(one, set()).add(other)
            found.setdefault(other, set()).add(one)
    return found


def _published(method: str) -> PublishedMethod:
    values = (
        PublishedValue(task, metric, float(printed.text), printed.is_our_unit)
        for (task, metric), printed in paper_values(method).items()
    )
    return PublishedMethod(method, tuple(values))


def _left_out(refusals: Iterable[Refusal]) -> tuple[LeftOut, ...]:
    return tuple(LeftOut(one.name, one.reasons) for one in refusals)
