"""The board as data: every writer draws the same rows."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from minitouch_bench.leaderboard.proof import RANKED_LEVELS
from minitouch_bench.leaderboard.ranking import Rank, break_ties, rank
from minitouch_bench.leaderboard.scores import MEAN_SUCCESS, OVERALL, Refusal, ScoredSubmission
from minitouch_bench.leaderboard.twins import exact_twins, near_twins
from minitouch_bench.metrics.definitions import metrics_shown_in
from minitouch_bench.metrics.metric import ShownIn
from minitouch_bench.policies.formats import BUILT_IN
from minitouch_bench.protocol.minitouch import PROTOCOL

CEILING = "scripted"
FLOORS = tuple(name for name in BUILT_IN if name != CEILING)
CALIBRATION = (CEILING, *FLOORS)
"""The built-in policies in the order of every table."""

TOUCH_METRICS = metrics_shown_in(ShownIn.BOARD)
"""The touch diagnostics of every task."""


@dataclass(frozen=True)
class BoardRow:
    """One submission on the board. ``ranks`` by task and OVERALL, where the row has any.

    ``twins`` are other submissions with the very same episodes, bit for bit; ``near_twins``
    those whose actions are nearly the same.
    """

    scored: ScoredSubmission
    ranks: Mapping[str, Rank]
    twins: tuple[str, ...] = ()
    near_twins: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The submission's name."""
        return self.scored.name

    @property
    def repeats(self) -> str:
        """What it repeats of others, in words; "" if nothing."""
        found = (("same episodes as", self.twins), ("nearly the actions of", self.near_twins))
        return "; ".join(f"{words} {', '.join(names)}" for words, names in found if names)


@dataclass(frozen=True)
class Fact:
    """What a board tells of a row beside its figures: a column of its CSV and of its Markdown."""

    name: str
    label: str
    of: Callable[[BoardRow], str | int | tuple[str, ...]]
    is_text: bool = True


FACTS = (
    Fact("method", "Method", lambda row: row.scored.about.method),
    Fact("proof", "Proof", lambda row: row.scored.level.value),
    Fact("modalities", "Modalities", lambda row: row.scored.about.modalities),
    Fact(
        "training_steps",
        "Training steps",
        lambda row: row.scored.about.training_steps,
        is_text=False,
    ),
    Fact(
        "training_seeds", "Training seeds", lambda row: len(row.scored.about.seeds), is_text=False
    ),
    Fact("repeats", "Repeats", lambda row: row.repeats),
)


@dataclass(frozen=True)
class Board:
    """Everything a writer needs: ``ranked`` from the best down, ``calibration`` in its order.

    ``unranked``: submissions that nobody has run again, from the best figures down.
    """

    protocol: str
    protocol_digest: str
    ranked: tuple[BoardRow, ...]
    unranked: tuple[BoardRow, ...]
    calibration: tuple[BoardRow, ...]
    missing_calibration: tuple[str, ...]
    refusals: tuple[Refusal, ...]

    @property
    def rows(self) -> tuple[BoardRow, ...]:
        """The rows of this protocol, ranked ones first."""
        return (*self.ranked, *self.unranked, *self.calibration)

    @property
    def apart(self) -> tuple[Refusal, ...]:
        """The submissions of another protocol."""
        return tuple(refusal for refusal in self.refusals if refusal.is_other_protocol)

    @property
    def refused(self) -> tuple[Refusal, ...]:
        """The submissions that do not pass."""
        return tuple(refusal for refusal in self.refusals if not refusal.is_other_protocol)


def make_board(found: Sequence[ScoredSubmission | Refusal]) -> Board:
    """Rank the submissions of one protocol."""
    scored = sorted(
        (one for one in found if isinstance(one, ScoredSubmission)), key=lambda one: one.name
    )
    submitted = [one for one in scored if not one.is_calibration]
    contenders = [one for one in submitted if one.level in RANKED_LEVELS]
    others = [one for one in submitted if one.level not in RANKED_LEVELS]
    calibration = {one.name: one for one in scored if one.is_calibration}
    exact, near = exact_twins(scored), near_twins(scored)

    def row(one: ScoredSubmission, ranks: Mapping[str, Rank]) -> BoardRow:
        twins = exact.get(one.name, ())
        others = tuple(name for name in near.get(one.name, ()) if name not in twins)
        return BoardRow(one, ranks, twins, others)

    ranked = [row(one, ranks) for one, ranks in zip(contenders, rank(contenders), strict=True)]
    return Board(
        protocol=PROTOCOL.name,
        protocol_digest=PROTOCOL.digest(),
        ranked=tuple(in_order(ranked, OVERALL, MEAN_SUCCESS)),
        unranked=tuple(
            in_order(
                [row(one, {}) for one in others],
                OVERALL,
                MEAN_SUCCESS,
            )
        ),
        calibration=tuple(
            row(calibration[name], {}) for name in CALIBRATION if name in calibration
        ),
        missing_calibration=tuple(name for name in CALIBRATION if name not in calibration),
        refusals=tuple(one for one in found if isinstance(one, Refusal)),
    )


def in_order(rows: Sequence[BoardRow], key: str, metric: str) -> list[BoardRow]:
    """Order rows by their rank in a task or OVERALL; ``break_ties`` orders those of one rank."""

    def order(row: BoardRow) -> tuple[int, tuple[float, str]]:
        return row.ranks[key].best if row.ranks else 0, break_ties(row.scored, key, metric)

    return sorted(rows, key=order)
