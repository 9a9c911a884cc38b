"""A comparison as one page that opens offline: tables, maps, and commands that show episodes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from minitouch_bench.comparison import effect_tables
from minitouch_bench.comparison.comparison import (
    Comparison,
    RunPair,
    comparison_notes,
    comparison_tables,
    paired_with_first,
)
from minitouch_bench.comparison.pairing import Pairs
from minitouch_bench.episode import Role, role_of
from minitouch_bench.reporting import pages, tables
from minitouch_bench.reporting.charts import Figure
from minitouch_bench.reporting.labels import tasks_in_order
from minitouch_bench.reporting.maps import EpisodePair, change_figure
from minitouch_bench.runs.run import Run

LISTED_CHANGES = 10
"""Changed episodes that the page lists with their commands."""


@dataclass(frozen=True)
class PairView:
    """What the page shows of one run against the first."""

    pair: RunPair
    figure: Figure
    metrics: tuple[tables.Table, ...]
    changes: tuple[tables.Table, ...]


def comparison_html(comparison: Comparison, runs: Sequence[Run]) -> str:
    """Write a comparison of these runs as a page."""
    tasks = tasks_in_order(runs)
    views = [
        PairView(
            pair=pair,
            figure=change_figure(
                f"maps-{pair.second}", _by_task(pairs, tasks), (pair.first, pair.second)
            ),
            metrics=comparison_tables(pair),
            changes=tuple(
                block
                for block in effect_tables.changes_blocks(
                    pair.changes, (pair.first, pair.second), LISTED_CHANGES
                )
                if isinstance(block, tables.Table)
            ),
        )
        for pair, pairs in zip(comparison.pairs, paired_with_first(runs), strict=True)
    ]
    return pages.render_page(
        pages.TEMPLATES / "comparison.html.j2",
        scripts=("theme.js",),
        comparison=comparison,
        views=views,
        not_alike=effect_tables.NOT_ALIKE,
        notes=comparison_notes(),
    )


def _by_task(pairs: Pairs, tasks: Sequence[str]) -> Mapping[str, list[EpisodePair]]:
    """Return the final policies' pairs of each task that has some."""
    final = [both for key, both in pairs.items() if role_of(key) is Role.FINAL]
    found = {task: [both for both in final if both[0].task == task] for task in tasks}
    return {task: both for task, both in found.items() if both}
