"""The notes below the tables of a report: what a reader must know of their values."""

from collections.abc import Sequence

from minitouch_bench.metrics.summary import MIN_EPISODES, has_both_splits
from minitouch_bench.reporting.labels import RunSection
from minitouch_bench.reporting.paper import CAVEAT, CITATION, MARK, OTHER_UNIT, PAPER_METHODS

PAPER_NOTE = (
    f"{', '.join(PAPER_METHODS)}: the paper's own values, {CAVEAT} ({CITATION}). "
    f"{MARK} {OTHER_UNIT}: the paper does not say what it counts, so it is compared with nothing."
)


def table4_notes(sections: Sequence[RunSection]) -> tuple[str, ...]:
    """Return the notes below Table 4."""
    return (
        *label_notes(sections),
        *_split_notes(sections),
        "Brackets: 95 % interval, Wilson for shares, bootstrap over episodes for means; "
        "episode variance only (one training seed).",
        PAPER_NOTE,
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
