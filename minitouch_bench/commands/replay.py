"""The command ``replay``: look at one recorded episode of a run, without its policy."""

from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli import options
from minitouch_bench.cli.console import note
from minitouch_bench.errors import CHECK_FAILED, UsageError
from minitouch_bench.files import REPLAYS, make_folder, view_name
from minitouch_bench.text import numbered

VIEWER = ".html"


def replay(
    run: options.RunDirectory,
    episode: Annotated[
        str,
        typer.Argument(
            metavar="EPISODE", help="Its key, such as pushing/17 or exploration/pushing/17."
        ),
    ],
    *,
    video: Annotated[
        bool,
        typer.Option(
            "--video", help="Also record a video: .mp4, or .gif without the extra 'video'."
        ),
    ] = False,
    csv: Annotated[
        bool,
        typer.Option(
            "--csv", help="Also write forces, openings, contact and action of each control step."
        ),
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.html",
            help="By default in RUN/replays/, or in reports/ for a run of a submission; the other "
            "files are written beside it.",
        ),
    ] = None,
) -> None:
    """Replay a recorded episode without its policy, and write a page that shows what it felt."""
    from minitouch_bench.reporting.report import view_directory
    from minitouch_bench.runs.run import read_run
    from minitouch_bench.verification import filming, replay_check, static_check

    if output is not None and output.suffix != VIEWER:
        raise UsageError(f"--output is an {VIEWER} file, not '{output.name}'")
    opened = read_run(run)
    static_check.refuse_unplayable(opened)
    spec, row = opened.find(episode)
    if output is None:
        folder = make_folder(view_directory(opened.directory or run) / REPLAYS)
        output = folder / view_name(episode, VIEWER)
    suffixes = (VIEWER, *([filming.video_suffix()] if video else ()), *([".csv"] if csv else ()))
    files = [output.with_suffix(suffix) for suffix in suffixes]
    played = filming.film_to_files(opened, (spec, files))
    print(*files, sep="\n")
    is_same = replay_check.is_as_recorded(opened, played)
    bits = "the same bits as recorded" if is_same else "NOT the bits that were recorded"
    ending, steps = row.outcome.replace("_", " "), len(played.trace.actions)
    note(f"{episode}: {ending} after {numbered(steps, 'step')}; {bits}")
    if not is_same:
        raise typer.Exit(CHECK_FAILED)
