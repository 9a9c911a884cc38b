"""A report of one or several runs as data; the writers add only form."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from urllib.parse import quote

from minitouch_bench.errors import UsageError
from minitouch_bench.rendering.charts import Figure
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.latex import table_source
from minitouch_bench.rendering.tables import Table
from minitouch_bench.reporting.labels import (
    RunOrigin,
    RunSection,
    describe_runs,
    tasks_in_order,
)
from minitouch_bench.reporting.tables import diagnostics, novel_shapes, table4
from minitouch_bench.runs.run import Run


@dataclass(frozen=True)
class Video:
    """A video beside the report: its caption, and its address relative to the report."""

    caption: str
    address: str


@dataclass(frozen=True)
class OverRuns:
    """What several runs show together; ``curve_csv``: the numbers of their learning curve."""

    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    curve_csv: str = ""


@dataclass(frozen=True)
class Report:
    """What every writer of a report shows.

    ``novel_shapes``: the gaps and the families, empty where no run has both splits.
    ``over_runs``: what several runs show together.
    """

    title: str
    tasks: tuple[str, ...]
    sections: tuple[RunSection, ...]
    table4: Table
    diagnostics: Table
    novel_shapes: tuple[Table, ...]
    videos: tuple[Video, ...]
    over_runs: OverRuns


@dataclass(frozen=True)
class AcrossRuns:
    """How the runs of a report belong together.

    ``origins``: the training of each; none where nothing is known. ``curve``: draw them over
    training steps, which are ``steps`` where these are given.
    """

    origins: tuple[RunOrigin, ...] = ()
    curve: bool = False
    steps: tuple[int, ...] = ()


ALONE = AcrossRuns()


def build_report(
    runs: Sequence[Run],
    videos: Sequence[Video] = (),
    names: Sequence[str] | None = None,
    across: AcrossRuns = ALONE,
) -> Report:
    """Compose the report of one or several runs, called ``names`` or by their policies.

    Of a curve ``names`` are those of the trainings.

    Raises:
        UsageError: no runs; runs of which a task was played by other rules;
            names or steps that do not fit the runs.
    """
    if not runs:
        raise UsageError("a report needs at least one run")
    _check_protocols(runs)
    sections = describe_runs(runs, None if across.curve else names)
    return Report(
        title=" · ".join(section.name for section in sections),
        tasks=tasks_in_order(runs),
        sections=sections,
        table4=table4(sections),
        diagnostics=diagnostics(sections),
        novel_shapes=novel_shapes(sections),
        videos=tuple(videos),
        over_runs=_over_runs(sections, across, names),
    )


def _over_runs(
    sections: Sequence[RunSection], across: AcrossRuns, names: Sequence[str] | None
) -> OverRuns:
    """Return what the runs show together: their curve, or their means over tasks and seeds."""
    if len(sections) == 1 and not across.curve:
        return OverRuns()
    # Not at the top: pandas takes half a second, and one run needs none of it.
    from minitouch_bench.reporting import curve, over_runs  # noqa: PLC0415

    runs = [section.run for section in sections]
    origins = across.origins or (RunOrigin(),) * len(runs)
    if across.curve:
        points = curve.make_curve(curve.label_curve(runs, origins, across.steps, names), runs)
        figures = (curve.curve_figure(points),)
        return OverRuns((curve.curve_table(points),), figures, curve.curve_csv(points))
    return OverRuns(
        *over_runs.compare_methods(over_runs.label_methods(sections, origins), sections)
    )


def table4_latex(report: Report) -> str:
    """Write Table 4 as LaTeX, ready for a paper."""
    header = report.sections[0].run.header
    caption = f"MiniTouch, protocol {header.protocol}, suite {header.plan.suite}, beside the paper."
    return table_source(report.table4, caption)


def find_videos(files: Sequence[Path], directory: Path) -> tuple[Video, ...]:
    """Describe video files for a report that will stand in ``directory``."""
    return tuple(
        Video(
            caption=printable(file.stem.replace("_", " ")),
            address=quote(Path(os.path.relpath(file, directory)).as_posix()),
        )
        for file in sorted(files)
    )


def _check_protocols(runs: Sequence[Run]) -> None:
    for first, other in combinations(runs, 2):
        if tasks := first.header.rules_differ(other.header):
            raise UsageError(
                f"{_protocol_of(first)} and {_protocol_of(other)} cannot be in one table: "
                f"the rules of {', '.join(tasks)} differ"
            )


def _protocol_of(run: Run) -> str:
    header = run.header
    return f"'{run.name}' ({header.protocol}, {header.protocol_digest[:12]})"
