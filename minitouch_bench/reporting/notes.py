"""The notes below every table of a report: what a reader must know of its values."""

from collections.abc import Sequence

from minitouch_bench.metrics.summary import MIN_EPISODES, has_both_splits
from minitouch_bench.rendering.tables import ABSENT
from minitouch_bench.reporting.labels import RunSection
from minitouch_bench.reporting.paper import CAVEAT, CITATION, MARK, OTHER_UNIT, PAPER_METHODS

PAPER_NOTE = (
    f"{', '.join(PAPER_METHODS)}: the paper's own values, {CAVEAT} ({CITATION}). "
    f"{MARK} {OTHER_UNIT}: the paper does not say what it counts, so it is compared with nothing."
)

NO_DIFFERENCE = "no difference seen"
"""The verdict on a gap whose interval holds 0."""


def table4_notes(sections: Sequence[RunSection]) -> tuple[str, ...]:
    """Return the notes below Table 4."""
    return (
        *label_notes(sections),
        *_split_notes(sections),
        "Brackets: 95 % interval, Wilson for shares, bootstrap over episodes for means; "
        "episode variance only (one training seed).",
        PAPER_NOTE,
    )


def diagnostics_notes(sections: Sequence[RunSection]) -> tuple[str, ...]:
    """Return the notes below the diagnostics."""
    return (
        *label_notes(sections),
        "First touch: mean over the episodes that touched. Object movement: variance over "
        "the episode of the object's position, or of the door's angle.",
    )


def gap_notes(sections: Sequence[RunSection], rows: int) -> tuple[str, ...]:
    """Return the notes below the gaps between held-out and train shapes."""
    return (
        *label_notes(sections),
        "Held-out: shapes that training never sees. Gap: held-out minus train. Brackets: 95 % "
        "interval, Wilson for a share and Newcombe for the gap of two, else bootstrap over "
        "episodes.",
        f"“{NO_DIFFERENCE}”: the interval holds 0, which does not prove that there is none. "
        f"Each of the {rows} rows is judged by itself: where there is no gap at all, one "
        "interval in 20 still misses 0.",
    )


def family_notes(sections: Sequence[RunSection]) -> tuple[str, ...]:
    """Return the notes below the values of each family of shapes."""
    return (
        *label_notes(sections),
        f"n: episodes. {ABSENT}: the run has no such shape in that split.",
    )


def label_notes(sections: Sequence[RunSection]) -> tuple[str, ...]:
    """Return one note for each run that has labels."""
    return tuple(f"* {one.name}: {'; '.join(one.labels)}." for one in sections if one.labels)


def _split_notes(sections: Sequence[RunSection]) -> tuple[str, ...]:
    """Say that a value is over both splits of a shape set, where one is."""
    mixed = [one.run for one in sections if has_both_splits(one.run.episodes)]
    if not mixed:
        return ()
    over = "Values are over all shapes, held-out and train together"
    if any(run.summary.generalization for run in mixed):
        return (f"{over}; “Novel shapes” has them apart.",)
    return (f"{over}; a gap between the two needs {MIN_EPISODES} episodes of each.",)
