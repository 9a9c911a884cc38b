"""The board as data: every writer draws the same rows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from minitouch_bench.leaderboard.entries import Entry
from minitouch_bench.leaderboard.failures import Ending, count_endings
from minitouch_bench.leaderboard.gaps import score_gaps
from minitouch_bench.leaderboard.ranking import Rank, rank
from minitouch_bench.leaderboard.scores import MEAN_SUCCESS, OVERALL, Figures, score
from minitouch_bench.leaderboard.submission import MAIN_SUITE
from minitouch_bench.leaderboard.validation import Verdict
from minitouch_bench.metrics import ShownIn, metrics_shown_in
from minitouch_bench.policies.loading import BUILT_IN
from minitouch_bench.protocol.minitouch import PROTOCOL, TASK_NAMES
from minitouch_bench.records import Estimate, Gap, Role

CEILING = "scripted"
FLOORS = tuple(name for name in BUILT_IN if name != CEILING)
CALIBRATION = (CEILING, *FLOORS)
"""The built-in policies in the order of every table."""

TOUCH_METRICS = metrics_shown_in(ShownIn.BOARD)
"""The touch diagnostics of every task."""


@dataclass(frozen=True)
class BoardRow:
    """One submission on the board. ``ranks`` by task and OVERALL, none for a calibration.

    ``twins`` are other submissions with the very same episodes, bit for bit.
    """

    entry: Entry
    figures: Figures
    ranks: Mapping[str, Rank]
    gaps: Mapping[str, Gap]
    endings: Mapping[str, Mapping[Ending, int]]
    twins: tuple[str, ...] = ()

    def estimate(self, task: str, metric: str) -> Estimate | None:
        """Return an estimate, None where there is none."""
        return self.figures.get((task, metric))


@dataclass(frozen=True)
class Board:
    """Everything a writer needs: ``ranked`` from the best down, ``calibration`` in its order."""

    protocol: str
    protocol_digest: str
    ranked: tuple[BoardRow, ...]
    calibration: tuple[BoardRow, ...]
    missing_calibration: tuple[str, ...]
    apart: tuple[Verdict, ...]
    refused: tuple[Verdict, ...]

    @property
    def rows(self) -> tuple[BoardRow, ...]:
        """The rows of this protocol, ranked ones first."""
        return (*self.ranked, *self.calibration)


def make_board(
    entries: Sequence[Entry], apart: Sequence[Verdict] = (), refused: Sequence[Verdict] = ()
) -> Board:
    """Score and rank the submissions of one protocol."""
    ordered = sorted(entries, key=lambda entry: entry.name)
    contenders = [entry for entry in ordered if not entry.is_calibration]
    calibration = sorted(
        (entry for entry in ordered if entry.is_calibration),
        key=lambda entry: CALIBRATION.index(entry.name),
    )
    ranks = rank(contenders)
    everyone = [*contenders, *calibration]
    figures, gaps = score(everyone), score_gaps(everyone)
    twins = _twins(everyone)
    no_ranks: list[Mapping[str, Rank]] = [{} for _ in calibration]
    rows = [
        BoardRow(entry, own, places, lost, _endings(entry), twins.get(entry.name, ()))
        for entry, own, places, lost in zip(
            everyone, figures, [*ranks, *no_ranks], gaps, strict=True
        )
    ]
    ranked = sorted(rows[: len(contenders)], key=_standing)
    return Board(
        protocol=PROTOCOL.name,
        protocol_digest=PROTOCOL.digest(),
        ranked=tuple(ranked),
        calibration=tuple(rows[len(contenders) :]),
        missing_calibration=tuple(
            name for name in CALIBRATION if name not in {entry.name for entry in calibration}
        ),
        apart=tuple(apart),
        refused=tuple(refused),
    )


def _standing(row: BoardRow) -> tuple[int, float, str]:
    """Order by rank, rows of one rank by mean success, then by name."""
    score = row.figures[OVERALL, MEAN_SUCCESS].value
    return row.ranks[OVERALL].best, -score, row.entry.name


def _endings(entry: Entry) -> dict[str, dict[Ending, int]]:
    return {
        task: count_endings(entry.episodes(MAIN_SUITE, Role.FINAL, task), task)
        for task in TASK_NAMES
    }


def _twins(entries: Sequence[Entry]) -> dict[str, tuple[str, ...]]:
    """Return by name the other entries whose episodes of the main suite are the same bits."""
    owners: dict[str, list[str]] = {}
    for entry in entries:
        for seed in entry.seeds:
            owners.setdefault(seed.runs[MAIN_SUITE].digest, []).append(entry.name)
    found: dict[str, set[str]] = {}
    for names in owners.values():
        for name in names:
            found.setdefault(name, set()).update(other for other in names if other != name)
    return {name: tuple(sorted(others)) for name, others in found.items() if others}
