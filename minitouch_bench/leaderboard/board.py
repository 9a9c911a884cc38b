"""The board as data: what ``leaderboard.json`` holds, and what every other writer shows.

Its schema is published as ``docs/leaderboard.schema.json``.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from typing import Any, Literal

from minitouch_bench.episode import Count, Episode, Sha256
from minitouch_bench.errors import printable
from minitouch_bench.leaderboard import ranking
from minitouch_bench.leaderboard.proof import FreshProof, ProofLevel
from minitouch_bench.leaderboard.ranking import OVERALL, RANKED_BY, Pair, Rank
from minitouch_bench.leaderboard.submission import BOARD_TASKS, About
from minitouch_bench.leaderboard.validation import SubmissionFindings, find_copies
from minitouch_bench.metrics.definitions import METRICS, ShownIn, metrics_shown_in
from minitouch_bench.metrics.intervals import Estimate
from minitouch_bench.metrics.summary import Gap
from minitouch_bench.policies.formats import BUILT_IN
from minitouch_bench.protocol.minitouch import MAIN_SUITE, NOVEL_SHAPES, PROTOCOL
from minitouch_bench.reporting.pages import Ending, ending_of

CEILING = "scripted"
FLOORS = tuple(name for name in BUILT_IN if name != CEILING)
CALIBRATION_POLICIES = (CEILING, *FLOORS)
"""The built-in policies in the order of every table."""

TOUCH_METRICS = metrics_shown_in(ShownIn.BOARD)
"""The touch diagnostics of every task."""


@dataclass(frozen=True, kw_only=True)
class BoardRow(About):
    """A submission: what it says of itself, how well it is proved, and its figures.

    ``labels``: what every table says of its policies, such as "remote".
    ``same_episodes_as`` names the submissions with a run of which at least half of the episodes
    are the same, bit for bit; ``runs`` has the digest of each run. ``ranks`` by task and "overall",
    empty for a calibration policy; ``figures`` by task (or "overall") and metric, in the units that
    ``docs/reference/metrics.md`` gives; ``novel_shapes`` by task: the metric that ranks it on
    held-out and on train shapes, and held-out minus train. ``learned``: how many training seeds
    learned each task with a goal. ``endings``: number of episodes by how they ended.
    """

    proof: ProofLevel
    labels: tuple[str, ...]
    rerun_episodes: Count
    fresh: FreshProof | None
    same_episodes_as: tuple[str, ...]
    training_seeds: tuple[Count, ...]
    runs: Mapping[str, Sha256]
    ranks: Mapping[str, Rank]
    figures: Mapping[str, Mapping[str, Estimate]]
    novel_shapes: Mapping[str, Gap]
    learned: Mapping[str, Count]
    endings: Mapping[str, Mapping[Ending, Count]]

    @property
    def is_calibration(self) -> bool:
        """Whether it is one of the built-in policies, which are shown and never ranked."""
        return self.name in BUILT_IN

    @property
    def is_ranked(self) -> bool:
        """Whether it has a rank."""
        return self.proof is ProofLevel.VERIFIED and not self.is_calibration

    def learned_in(self, task: str) -> str:
        """Say how many of several training seeds learned a task, or OVERALL all; "" for one."""
        seeds = len(self.training_seeds)
        if seeds == 1 or task not in (OVERALL, *self.learned):
            return ""
        if task == OVERALL:
            trainings = f"{sum(self.learned.values())} of {seeds * len(self.learned)} trainings"
            return f"{trainings} learned"
        return f"{self.learned[task]} of {seeds} seeds learned"

    def estimate(self, task: str, metric: str) -> Estimate | None:
        """Return an estimate, None where there is none."""
        return self.figures.get(task, {}).get(metric)


def in_words(value: object) -> str:
    """Write a value for people; "" where there is none."""
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value or "")


def amount(number: int) -> str:
    """Write a large number short: 2 M, 1.5 k; one that is not exact with three digits."""
    rounded = float(f"{number:.3g}")
    for size, unit in ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")):
        if rounded >= size:
            return f"{rounded / size:.3g}\u202f{unit}"
    return str(number) if number else "none"


def _repeats(others: tuple[str, ...]) -> str:
    return f"same episodes as {in_words(others)}" if others else ""


def _seeds(seeds: tuple[int, ...]) -> str:
    return "1 seed" if len(seeds) == 1 else f"{len(seeds)} seeds"


@dataclass(frozen=True)
class ColumnSpec:
    """How a field of ``BoardRow`` is shown.

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
    write: Callable[[Any], str] = in_words
    is_text: bool = True
    is_link: bool = False


COLUMN_SPECS: Mapping[str, ColumnSpec] = {
    "method": ColumnSpec("Method", "name"),
    "authors": ColumnSpec("Authors"),
    "paper": ColumnSpec("Paper", is_link=True),
    "code": ColumnSpec("Code", is_link=True),
    "license": ColumnSpec("License"),
    "training_steps": ColumnSpec("Training", "column", "control steps", amount, is_text=False),
    "modalities": ColumnSpec("Modalities", "name"),
    "notes": ColumnSpec("Notes"),
    "proof": ColumnSpec("Proof", "column"),
    "labels": ColumnSpec("Labels", "name"),
    "same_episodes_as": ColumnSpec("Repeats", "name", write=_repeats),
    "training_seeds": ColumnSpec("Training seeds", "name", write=_seeds),
}
"""The columns of the board, beside its estimates: fields of ``BoardRow`` in order."""


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
    submissions that do not pass. ``pairs``: by task and "overall", every two of the ranked rows.
    """

    format: Literal["minitouch-leaderboard"]
    version: Literal[5]
    protocol: str
    protocol_digest: str
    ranked: tuple[BoardRow, ...]
    unranked: tuple[BoardRow, ...]
    calibration: tuple[BoardRow, ...]
    missing_calibration: tuple[str, ...]
    other_protocol: tuple[LeftOut, ...]
    refused: tuple[LeftOut, ...]
    pairs: Mapping[str, tuple[Pair, ...]]

    @property
    def rows(self) -> tuple[BoardRow, ...]:
        """The rows of this protocol, ranked ones first."""
        return (*self.ranked, *self.unranked, *self.calibration)


def make_board(findings: Sequence[SubmissionFindings]) -> Board:
    """Rank the submissions of one protocol that passed, and list those that did not."""
    passed = {found.submission.name: found for found in findings if found.passed}
    by_name = dict(sorted(passed.items()))
    repeated = _same_episodes(by_name)
    rows = {name: _row(found, repeated.get(name, ())) for name, found in by_name.items()}
    ranked = [name for name, row in rows.items() if row.is_ranked]
    rankings = ranking.rank({name: _values(by_name[name]) for name in ranked})
    for place, name in enumerate(ranked):
        ranks = {key: table.ranks[place] for key, table in rankings.items()}
        rows[name] = replace(rows[name], ranks=ranks)
    left_out: dict[bool, list[LeftOut]] = {False: [], True: []}
    for found in findings:
        if not found.passed:
            refusal = LeftOut(printable(found.directory.name), tuple(map(str, found.problems)))
            left_out[found.is_other_protocol].append(refusal)
    submitted = in_order([row for row in rows.values() if not row.is_calibration], OVERALL)
    return Board(
        format="minitouch-leaderboard",
        version=5,
        protocol=PROTOCOL.name,
        protocol_digest=PROTOCOL.digest(),
        ranked=tuple(row for row in submitted if row.is_ranked),
        unranked=tuple(row for row in submitted if not row.is_ranked),
        calibration=tuple(rows[name] for name in CALIBRATION_POLICIES if name in rows),
        missing_calibration=tuple(name for name in CALIBRATION_POLICIES if name not in rows),
        other_protocol=tuple(left_out[True]),
        refused=tuple(left_out[False]),
        pairs={key: table.pairs for key, table in rankings.items()},
    )


def _row(found: SubmissionFindings, repeated: Iterable[str]) -> BoardRow:
    about, proof = found.submission, found.proof
    policies = [policy for run in found.runs.values() for policy in run.header.policies()]
    return BoardRow(
        **{field.name: getattr(about, field.name) for field in fields(About)},
        proof=found.level,
        labels=tuple(dict.fromkeys(note for policy in policies for note in policy.notes)),
        rerun_episodes=proof.rerun_episodes if proof else 0,
        fresh=proof.fresh if proof else None,
        same_episodes_as=tuple(sorted(repeated)),
        training_seeds=tuple(seed.seed for seed in about.seeds),
        runs={folder: run.digest for folder, run in found.runs.items()},
        ranks={},
        figures=ranking.score(found.runs_on(MAIN_SUITE)),
        novel_shapes=ranking.score_gaps(found.runs_on(NOVEL_SHAPES)),
        learned=ranking.count_learned(found.runs_on(MAIN_SUITE)),
        endings={task: _endings(chain(*found.episodes(task))) for task in BOARD_TASKS},
    )


def _endings(episodes: Iterable[Episode]) -> dict[Ending, int]:
    """Return how many episodes ended in each way that occurs."""
    counts = Counter(map(ending_of, episodes))
    return {ending: counts[ending] for ending in Ending if counts[ending]}


def _values(found: SubmissionFindings) -> dict[str, list[list[float]]]:
    """Return what ranks each task: of each training seed, the value of every episode."""
    return {
        task: [METRICS[RANKED_BY[task]].values(episodes) for episodes in found.episodes(task)]
        for task in BOARD_TASKS
    }


def in_order(rows: Sequence[BoardRow], key: str) -> list[BoardRow]:
    """Order rows by what ranks a task or OVERALL, then the name.

    Not by ``Rank.best``: a row whose training seeds differ much is not significantly worse
    than any other, and would be listed above rows that are better.
    """
    return sorted(rows, key=lambda row: (-row.figures[key][RANKED_BY[key]].value, row.name))


def _same_episodes(findings: Mapping[str, SubmissionFindings]) -> dict[str, set[str]]:
    """Return by name the others with a main run of the same episodes.

    A proved row is not called a copy of one that is not.
    """
    runs = {
        (name, seed): run
        for name, found in findings.items()
        for seed, run in enumerate(found.runs_on(MAIN_SUITE))
    }
    others: dict[str, set[str]] = {}
    proved = {name for name, found in findings.items() if found.proof is not None}
    for (first, _), (second, _) in find_copies(runs):
        for name, other in ((first, second), (second, first)):
            if name != other and (other in proved or name not in proved):
                others.setdefault(name, set()).add(other)
    return others
