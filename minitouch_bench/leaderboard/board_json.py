"""``leaderboard.json``; its schema is published as ``docs/leaderboard.schema.json``."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from minitouch_bench.documents import schema_of, write_json
from minitouch_bench.leaderboard.board import Board, BoardRow
from minitouch_bench.leaderboard.entries import Ending
from minitouch_bench.leaderboard.proof import FreshProof, ProofLevel
from minitouch_bench.leaderboard.ranking import Rank
from minitouch_bench.leaderboard.scores import Refusal
from minitouch_bench.records import Count, Estimate, Gap, Sha256
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.paper import PAPER_METHODS, paper_values
from minitouch_bench.reporting.run_directory import with_task_names

FORMAT: Final = "minitouch-leaderboard"
VERSION: Final = 2


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
class RowDocument:
    """A submission: what it tells, how well it is proved, and its figures.

    ``same_episodes_as`` names the submissions with the very same episodes, bit for bit,
    ``nearly_same_actions_as`` those with nearly the same actions; ``runs``
    has the digest of each run. ``ranks`` by task and "overall", empty for a calibration policy;
    ``figures`` by task (or "overall") and metric, in the units that ``docs/metrics.md`` gives;
    ``novel_shapes`` by task: the metric that ranks it on held-out and on train shapes, and
    held-out minus train. ``endings``: number of episodes by how they ended.
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
    nearly_same_actions_as: tuple[str, ...]
    training_seeds: tuple[Count, ...]
    runs: Mapping[str, Sha256]
    ranks: Mapping[str, Rank]
    figures: Mapping[str, Mapping[str, Estimate]]
    novel_shapes: Mapping[str, Gap]
    endings: Mapping[str, Mapping[Ending, Count]]


@dataclass(frozen=True)
class LeftOut:
    """A submission that is not on the board, with every reason."""

    name: str
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class BoardDocument:
    """The leaderboard of one protocol: ``ranked`` from the best down.

    ``calibration`` are the built-in policies, which are never ranked, ``missing_calibration``
    those without a submission. ``other_protocol``: submissions of another protocol; ``refused``:
    submissions that do not pass.
    """

    format: Literal["minitouch-leaderboard"]
    version: Literal[2]
    protocol: str
    protocol_digest: str
    ranked: tuple[RowDocument, ...]
    unranked: tuple[RowDocument, ...]
    calibration: tuple[RowDocument, ...]
    missing_calibration: tuple[str, ...]
    paper: tuple[PublishedMethod, ...]
    other_protocol: tuple[LeftOut, ...]
    refused: tuple[LeftOut, ...]


TOLD = ("name", "method", "authors", "paper", "code", "license", "training_steps", "modalities",
        "notes")  # fmt: skip
"""What a row repeats of its submission."""


def board_json(board: Board) -> bytes:
    """Write a board as JSON.

    Raises:
        ValueError: it holds NaN or infinity.
    """
    return write_json(
        BoardDocument(
            format=FORMAT,
            version=VERSION,
            protocol=board.protocol,
            protocol_digest=board.protocol_digest,
            ranked=tuple(map(_row, board.ranked)),
            unranked=tuple(map(_row, board.unranked)),
            calibration=tuple(map(_row, board.calibration)),
            missing_calibration=board.missing_calibration,
            paper=tuple(map(_published, PAPER_METHODS)),
            other_protocol=tuple(map(_left_out, board.apart)),
            refused=tuple(map(_left_out, board.refused)),
        )
    )


def board_schema() -> dict[str, Any]:
    """Return the JSON schema of ``leaderboard.json``."""
    return with_task_names(schema_of(BoardDocument, "The MiniTouch leaderboard"))


def _row(row: BoardRow) -> RowDocument:
    scored = row.scored
    return RowDocument(
        **{name: getattr(row.scored.about, name) for name in TOLD},
        proof=scored.level,
        rerun_episodes=scored.rerun_episodes,
        fresh=scored.fresh,
        same_episodes_as=row.twins,
        nearly_same_actions_as=row.near_twins,
        training_seeds=tuple(seed.seed for seed in row.scored.about.seeds),
        runs=scored.runs,
        ranks=row.ranks,
        figures=scored.figures,
        novel_shapes=scored.gaps,
        endings=scored.endings,
    )


def _published(method: str) -> PublishedMethod:
    values = (
        PublishedValue(task, metric, float(printed.text), printed.is_our_unit)
        for (task, metric), printed in paper_values(method).items()
    )
    return PublishedMethod(method, tuple(values))


def _left_out(refusal: Refusal) -> LeftOut:
    return LeftOut(printable(refusal.name), refusal.reasons)
