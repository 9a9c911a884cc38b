"""A report of one or several runs as data, and its files."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from minitouch_bench.errors import UsageError
from minitouch_bench.records import SavedRun
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.tables import Table
from minitouch_bench.reporting.labels import (
    reproduce_command,
    run_labels,
    run_names,
    tasks_in_order,
)
from minitouch_bench.reporting.novel_shapes import novel_shapes
from minitouch_bench.reporting.tables import diagnostics, table4


@dataclass(frozen=True)
class Fault:
    """What a policy did wrong, and in which episodes."""

    text: str
    episodes: tuple[str, ...]


@dataclass(frozen=True)
class RunSection:
    """One run in a report: its name there, its labels, faults and command line."""

    name: str
    labels: tuple[str, ...]
    faults: tuple[Fault, ...]
    command: str
    run: SavedRun


@dataclass(frozen=True)
class Video:
    """A video beside the report: its caption, and its address relative to the report."""

    caption: str
    address: str


@dataclass(frozen=True)
class Report:
    """Everything a writer needs; the writers add only form.

    ``novel_shapes``: the gaps and the families, empty where no run has both splits.
    """

    title: str
    tasks: tuple[str, ...]
    sections: tuple[RunSection, ...]
    table4: Table
    diagnostics: Table
    novel_shapes: tuple[Table, ...] = ()
    videos: tuple[Video, ...] = ()


def build_report(runs: Sequence[SavedRun], videos: Sequence[Video] = ()) -> Report:
    """Compose the report of one or several runs.

    Errors: UsageError for no runs, and for runs of different protocols, which are never
    put into one table.
    """
    if not runs:
        raise UsageError("a report needs at least one run")
    _check_protocols(runs)
    names = run_names(runs)
    return Report(
        title=" · ".join(names),
        tasks=tasks_in_order(runs),
        sections=tuple(_section(name, run) for name, run in zip(names, runs, strict=True)),
        table4=table4(runs),
        diagnostics=diagnostics(runs),
        novel_shapes=novel_shapes(runs),
        videos=tuple(videos),
    )


def find_videos(files: Sequence[Path], directory: Path) -> tuple[Video, ...]:
    """Describe video files for a report that will stand in ``directory``."""
    return tuple(
        Video(
            caption=printable(file.stem.replace("_", " ")),
            address=quote(Path(os.path.relpath(file, directory)).as_posix()),
        )
        for file in sorted(files)
    )


def _check_protocols(runs: Sequence[SavedRun]) -> None:
    """Refuse runs whose protocol digests differ."""
    first = runs[0]
    for other in runs[1:]:
        if other.header.protocol_digest != first.header.protocol_digest:
            raise UsageError(
                f"{_protocol_of(first)} and {_protocol_of(other)} cannot be compared: "
                "their protocols differ"
            )


def _protocol_of(run: SavedRun) -> str:
    """Name a run with its protocol."""
    header = run.header
    return f"'{run.name}' ({header.protocol}, {header.protocol_digest[:12]})"


def _section(name: str, run: SavedRun) -> RunSection:
    """Compose the section of one run; equal faults are told once."""
    episodes: dict[str, list[str]] = {}
    for key, text in run.faults.items():
        episodes.setdefault(printable(text), []).append(printable(key))
    return RunSection(
        name=name,
        labels=run_labels(run),
        faults=tuple(Fault(text, tuple(keys)) for text, keys in episodes.items()),
        command=reproduce_command(run.header),
        run=run,
    )
