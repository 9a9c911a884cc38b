"""The board as data: the content of ``leaderboard.json``, which every other writer shows.

Its schema is published as ``docs/leaderboard.schema.json``.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations
from typing import Any, Final, Literal

from minitouch_bench.episode import Count, Role, Sha256
from minitouch_bench.leaderboard import ranking
from minitouch_bench.leaderboard.fresh import SIGNIFICANCE
from minitouch_bench.leaderboard.play import FreshDraw, PlayedRow
from minitouch_bench.leaderboard.ranking import (
    MEAN_OF,
    OVERALL,
    RANKED_BY,
    Pair,
    Rank,
)
from minitouch_bench.leaderboard.submission import About
from minitouch_bench.metrics.definitions import METRICS, ShownIn, metrics_shown_in, ranking_metric
from minitouch_bench.metrics.intervals import Estimate
from minitouch_bench.metrics.summary import Gap
from minitouch_bench.policies.formats import BUILT_IN
from minitouch_bench.protocol.minitouch import NOVEL_SHAPES, PROTOCOL
from minitouch_bench.runs.run import Run
from minitouch_bench.text import numbered

FORMAT: Final = "minitouch-leaderboard"
"""Of the JSON document."""

CEILING = "scripted"
FLOORS = tuple(name for name in BUILT_IN if name != CEILING)
CALIBRATION_POLICIES = (CEILING, *FLOORS)
"""The built-in policies in the order of every table."""

TOUCH_METRICS = metrics_shown_in(ShownIn.BOARD)
"""The touch diagnostics of every task."""

COPIED_SHARE = 0.5
"""Share of a task's equal episodes that makes a training a copy: stored trainings share none."""


@dataclass(frozen=True, kw_only=True)
class BoardRow(About):
    """A row: what the submission says of itself, and what was measured when it was played.

    ``labels``: what every table says of its policies, such as "reads the simulator's state".
    ``played``: the day and the processor. ``copy_of``: a row that was played before with the same
    checkpoints or episodes, "" if there is none. ``drop_p``: see ``fresh.drop_p``. ``runs`` has the
    digest of each run. Ranks, figures and fresh figures are by the key of a table: a task of the
    main suite, "overall", or SUITE/TASK; ranks are empty for a row without a rank. Figures are by
    metric, in the units that ``docs/reference/metrics.md`` gives. ``novel_shapes`` by task: the
    metric that ranks it on held-out and on train shapes, and held-out minus train. ``learned``: how
    many training seeds learned each task with a goal, by the key of its table.
    """

    labels: tuple[str, ...]
    played: str
    copy_of: str
    drop_p: float
    training_seeds: tuple[Count, ...]
    runs: Mapping[str, Sha256]
    ranks: Mapping[str, Rank]
    figures: Mapping[str, Mapping[str, Estimate]]
    fresh: Mapping[str, Mapping[str, Estimate]]
    novel_shapes: Mapping[str, Gap]
    learned: Mapping[str, Count]

    @property
    def is_calibration(self) -> bool:
        """Whether it is one of the built-in policies, which are shown and never ranked."""
        return self.name in BUILT_IN

    @property
    def seeds_in_words(self) -> str:
        """How many training seeds it has, "" where nothing was trained."""
        count = len(self.training_seeds)
        seeds = "one training seed" if count == 1 else f"{count} training seeds"
        return seeds if self.training_steps else ""

    @property
    def why_no_rank(self) -> str:
        """Why it has no rank, "" where it has one."""
        if self.is_calibration:
            return "a built-in policy, for calibration"
        if self.copy_of == self.name:
            return "two of its trainings have the same policy in a task"
        if self.copy_of:
            return f"a copy of {self.copy_of}, which was played first"
        if self.drop_p < SIGNIFICANCE:
            return f"worse in fresh episodes than in the official ones (p = {self.drop_p:.2g})"
        return ""

    def learned_in(self, key: str) -> str:
        """Say how many training seeds learned a table's task or tasks; "" for one seed."""
        seeds = len(self.training_seeds)
        learned = [self.learned[one] for one in MEAN_OF.get(key, (key,)) if one in self.learned]
        if seeds == 1 or not learned:
            return ""
        if key in MEAN_OF:
            return f"{sum(learned)} of {seeds * len(learned)} trainings learned"
        return f"{learned[0]} of {seeds} seeds learned"

    def estimate(self, key: str, metric: str) -> Estimate | None:
        """Return an estimate, None where there is none."""
        return self.figures.get(key, {}).get(metric)


def value_in_words(value: object) -> str:
    """Write a value for people; "" where there is none."""
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value or "")


def amount(number: int) -> str:
    """Write a large number short, as 2 M or 1.5 k, with at most three digits."""
    rounded = float(f"{number:.3g}")
    for size, unit in ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")):
        if rounded >= size:
            return f"{rounded / size:.3g}\u202f{unit}"
    return str(number) if number else "none"


@dataclass(frozen=True)
class ColumnSpec:
    """How an attribute of ``BoardRow`` is shown.

    Args:
        label: Heading of the column.
        place: Where the field is shown beside the list on the submission's page, which has all
            of them. "column": in the Markdown file, and in a column of the site's overall table.
            "name": in that file, and below the row's name in that table. "page": nowhere else.
        unit: What a number counts.
        write: Gives the text for people, "" where there is nothing to say.
        is_text: Whether the column has words.
        is_link: Whether the value is an address.
    """

    label: str
    place: Literal["column", "name", "page"] = "page"
    unit: str = ""
    write: Callable[[Any], str] = value_in_words
    is_text: bool = True
    is_link: bool = False


COLUMN_SPECS: Mapping[str, ColumnSpec] = {
    "method": ColumnSpec("Method", "name"),
    "learner": ColumnSpec("Learner", "column"),
    "training_steps": ColumnSpec("Training", "column", "control steps", amount, is_text=False),
    "seeds_in_words": ColumnSpec("Training seeds", "name"),
    "modalities": ColumnSpec("Modalities", "name"),
    "labels": ColumnSpec("Labels", "name"),
    "played": ColumnSpec("Played", "column"),
    "authors": ColumnSpec("Authors"),
    "paper": ColumnSpec("Paper", is_link=True),
    "code": ColumnSpec("Code", is_link=True),
    "license": ColumnSpec("License"),
    "notes": ColumnSpec("Notes"),
}
"""The columns of the board, beside its estimates: attributes of ``BoardRow`` in order."""


@dataclass(frozen=True)
class LeftOut:
    """A submission that is not on the board, with the reason and what to do."""

    name: str
    reason: str


@dataclass(frozen=True)
class Board:
    """The leaderboard of one protocol: ``ranked`` from the best down.

    ``calibration`` are the built-in policies, which are never ranked; ``unranked`` have another
    reason for it. ``waiting``: submissions that are not played yet. ``left_out``: submissions and
    results that cannot be shown. ``pairs``: by the key of a table, every two of its ranked rows.
    """

    format: Literal["minitouch-leaderboard"]
    version: Literal[7]
    protocol: str
    protocol_digest: str
    ranked: tuple[BoardRow, ...]
    unranked: tuple[BoardRow, ...]
    calibration: tuple[BoardRow, ...]
    waiting: tuple[LeftOut, ...]
    left_out: tuple[LeftOut, ...]
    pairs: Mapping[str, tuple[Pair, ...]]

    @property
    def rows(self) -> tuple[BoardRow, ...]:
        """Every row, ranked ones first."""
        return (*self.ranked, *self.unranked, *self.calibration)


def make_board(
    played: Sequence[PlayedRow],
    waiting: Sequence[LeftOut] = (),
    left_out: Sequence[LeftOut] = (),
) -> Board:
    """Rank the rows that were played."""
    by_name = dict(sorted((one.submission.name, one) for one in played))
    copies = find_copies(by_name)
    rows = {name: _row(one, copies.get(name, "")) for name, one in by_name.items()}
    ranked = {name for name, row in rows.items() if not row.why_no_rank}
    rankings = ranking.rank(
        {name: ranking.values_by_key(by_name[name].official) for name in sorted(ranked)}
    )
    for name in ranked:
        ranks = {key: table.ranks[name] for key, table in rankings.items() if name in table.ranks}
        rows[name] = replace(rows[name], ranks=ranks)
    submitted = in_order([row for row in rows.values() if not row.is_calibration], OVERALL)
    return Board(
        format=FORMAT,
        version=7,
        protocol=PROTOCOL.name,
        protocol_digest=PROTOCOL.digest(),
        ranked=tuple(row for row in submitted if row.name in ranked),
        unranked=tuple(row for row in submitted if row.name not in ranked),
        calibration=tuple(rows[name] for name in CALIBRATION_POLICIES if name in rows),
        waiting=tuple(waiting),
        left_out=tuple(left_out),
        pairs={key: table.pairs for key, table in rankings.items()},
    )


def _row(played: PlayedRow, copy_of: str) -> BoardRow:
    about, official = played.submission, played.official
    runs = [run for of_suite in official.values() for run in of_suite]
    notes = (note for run in runs for policy in run.header.policies() for note in policy.notes)
    first = min(played.row.draws, key=lambda draw: draw.at)
    return BoardRow(
        **{field.name: getattr(about, field.name) for field in fields(About)},
        labels=(*dict.fromkeys(notes), *_retired(played)),
        played=f"{first.at[:10]}, {first.processor}",
        copy_of=copy_of,
        drop_p=played.row.drop_p,
        training_seeds=tuple(training.seed for training in about.trainings),
        runs={run.name.partition("/")[2]: run.digest for run in runs},
        ranks={},
        figures=ranking.score(official),
        fresh=ranking.score(played.fresh),
        novel_shapes=ranking.score_gaps(official.get(NOVEL_SHAPES, ())),
        learned=ranking.count_learned(official),
    )


def _retired(played: PlayedRow) -> list[str]:
    """Say how many trainings were played and are not in the submission any more."""
    number = len(played.row.retired)
    return [f"{numbered(number, 'training')} played, then taken out or replaced"] if number else []


def in_order(rows: Sequence[BoardRow], key: str) -> list[BoardRow]:
    """Order rows by what ranks a table: rows of several trainings by their value, then the name.

    Not by ``Rank.best``: a row whose trainings differ much is not significantly worse than any
    other, and would be listed above rows that are better. A row of one training comes directly
    below the last row of several whose interval reaches it, or goes beyond: it can be a lucky
    training of the same method. Rows without a value come last.
    """

    def place(row: BoardRow) -> tuple[float, str]:
        return -row.figures[key][RANKED_BY[key]].value, row.name

    shown = sorted((row for row in rows if key in row.figures), key=place)
    ordered = [row for row in shown if len(row.training_seeds) > 1]
    limits = [row.figures[key][RANKED_BY[key]].high for row in ordered]
    singles = [row for row in shown if len(row.training_seeds) == 1]
    for row in reversed(singles):  # so that the best of those at one place ends up first
        reach = [i for i, high in enumerate(limits) if high >= -place(row)[0]]
        ordered.insert(reach[-1] + 1 if reach else 0, row)
    return [*ordered, *(row for row in rows if key not in row.figures)]


PlayedTraining = tuple[str, FreshDraw]
"""The name of a row, and what one of its trainings was played with."""

ScoredEpisodes = dict[tuple[str, str], set[tuple[int, str]]]
"""By suite and task the index and the digest of the episodes that add to a training's rank."""


def find_copies(played: Mapping[str, PlayedRow]) -> dict[str, str]:
    """Return by the name of each copy the row that it repeats, which was played before it.

    A training repeats another where they share a final checkpoint, or at least COPIED_SHARE of a
    task's episodes that add to its rank, bit for bit: a copy that acts a little otherwise in most
    of its episodes is not seen.
    """
    files: dict[PlayedTraining, set[str]] = {}
    scored: dict[PlayedTraining, ScoredEpisodes] = {}
    for name, one in played.items():
        trainings = [(name, draw) for draw in one.row.draws]
        for training, submitted in zip(trainings, one.submission.trainings, strict=True):
            files[training] = {file.sha256 for file in submitted.files(Role.FINAL)}
            scored[training] = {}
        for suite, runs in one.official.items():
            for training, run in zip(trainings, runs, strict=True):
                scored[training] |= {(suite, task): _scored(run, task) for task in run.tasks}
    # A built-in policy is never a copy, whenever its row was played.
    order = sorted(files, key=lambda one: (one[1].final != "", one[1].at, one[0]))
    copies: dict[str, str] = {}
    for first, later in combinations(order, 2):
        if files[first] & files[later] or _share_episodes(scored[first], scored[later]):
            copies.setdefault(later[0], first[0])
    return copies


def _scored(run: Run, task: str) -> set[tuple[int, str]]:
    """Return a task's episodes that add to its rank: policies that do nothing act alike."""
    rows = [row for row in run.rows if row.task == task]
    values = METRICS[ranking_metric(task)].values(rows)
    return {(row.index, row.digest) for row, value in zip(rows, values, strict=True) if value > 0}


def _share_episodes(one: ScoredEpisodes, other: ScoredEpisodes) -> bool:
    """Tell whether two trainings share COPIED_SHARE of a task's episodes, of the smaller number."""
    both = ((one[key], other[key]) for key in one.keys() & other.keys())
    return any(
        len(first & second) >= max(1, COPIED_SHARE * min(len(first), len(second)))
        for first, second in both
    )
