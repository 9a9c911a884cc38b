"""``minitouch-bench replay``: the recorded actions of an episode, played again to be looked at."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from minitouch_bench import errors
from minitouch_bench.commands import options
from minitouch_bench.commands.options import argument, flag, option
from minitouch_bench.console import note
from minitouch_bench.files import REPLAYS, view_name
from minitouch_bench.text import numbered

if TYPE_CHECKING:
    from minitouch_bench.runs.run import Run

VIEWER = ".html"


def replay(
    run: options.RunDirectory,
    episode: Annotated[
        str, argument("EPISODE", "Its key, such as pushing/17 or exploration/pushing/17.")
    ],
    *,
    beside: Annotated[
        Path | None, option("RUN", "Show the same episode of another run on the same time axis.")
    ] = None,
    video: Annotated[
        bool, flag("--video", "Also record a video: .mp4, or .gif without the extra 'video'.")
    ] = False,
    csv: Annotated[
        bool, flag("--csv", "Also write forces, openings, contact and action of each control step.")
    ] = False,
    output: Annotated[
        Path | None,
        option("FILE.html", "By default in RUN/replays/; other files are written beside it."),
    ] = None,
) -> None:
    """Replay a recorded episode without its policy, and write a page that shows what it felt."""
    from minitouch_bench.reporting.report import view_directory
    from minitouch_bench.runs.run import read_run
    from minitouch_bench.verification import filming, replay_check, static_check

    if output is not None and output.suffix != VIEWER:
        raise errors.UsageError(f"--output is an {VIEWER} file, not '{output.name}'")
    if beside is not None and (video or csv):
        raise errors.UsageError("--beside writes a page alone: leave --video and --csv out")
    opened = read_run(run)
    static_check.refuse_unplayable(opened)
    spec, row = opened.find(episode)
    if output is None:
        folder = view_directory(opened.directory or run) / REPLAYS
        output = folder / view_name(episode, f"-beside{VIEWER}" if beside else VIEWER)
    if beside is not None:
        _replay_both(opened, read_run(beside), episode, output)
        return
    suffixes = (VIEWER, *([filming.video_suffix()] if video else ()), *([".csv"] if csv else ()))
    files = [output.with_suffix(suffix) for suffix in suffixes]
    played = filming.film_to_files(opened, (spec, files))
    print(*files, sep="\n")
    is_same = replay_check.is_as_recorded(opened, played)
    bits = "the same bits as recorded" if is_same else "NOT the bits that were recorded"
    ending, steps = row.outcome.replace("_", " "), len(played.trace.actions)
    note(f"{episode}: {ending} after {numbered(steps, 'step')}; {bits}")
    if not is_same:
        raise typer.Exit(errors.CHECK_FAILED)


def _replay_both(first: "Run", second: "Run", episode: str, output: Path) -> None:
    from minitouch_bench.reporting.viewer import episode_page
    from minitouch_bench.verification import filming

    filming.refuse_other_scene(episode, first, second)
    one, other = (filming.replay_episode(run, episode) for run in (first, second))
    print(episode_page(one, other).save(output))
    for played in (one, other):
        bits = "the same bits" if played.is_as_recorded else "NOT the bits"
        note(f"{played.run.place}: {played.ending}; {bits} as recorded")
    if not (one.is_as_recorded and other.is_as_recorded):
        raise typer.Exit(errors.CHECK_FAILED)
