"""``minitouch-bench replay``: the recorded actions of an episode, played again to be looked at."""

from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench import errors
from minitouch_bench.commands import options
from minitouch_bench.commands.options import argument, flag, option
from minitouch_bench.console import note
from minitouch_bench.files import REPLAYS, view_name, write_file
from minitouch_bench.text import numbered

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
    from minitouch_bench.reporting.viewer import episode_csv, episode_page
    from minitouch_bench.runs.run import read_run
    from minitouch_bench.verification import filming

    if output is not None and output.suffix != VIEWER:
        raise errors.UsageError(f"--output is an {VIEWER} file, not '{output.name}'")
    if beside is not None and (video or csv):
        raise errors.UsageError("--beside writes a page alone: leave --video and --csv out")
    runs = [read_run(one) for one in (run, beside) if one is not None]
    filming.refuse_other_scene(episode, runs[0], runs[-1])
    shown = [filming.replay_episode(one, episode) for one in runs]
    if output is None:
        folder = view_directory(runs[0].directory or run) / REPLAYS
        output = folder / view_name(episode, f"-beside{VIEWER}" if beside else VIEWER)
    print(episode_page(*shown).save(output))
    if video:
        filming.write_video(shown[0].film, file := output.with_suffix(filming.video_suffix()))
        print(file)
    if csv:
        write_file(file := output.with_suffix(".csv"), episode_csv(runs[0], shown[0].film))
        print(file)
    for one in shown:
        bits = "the same bits as recorded" if one.is_as_recorded else "NOT the bits as recorded"
        steps = numbered(len(one.film.played.trace.actions), "step")
        note(f"{one.run.place}: {one.ending} after {steps}; {bits}")
    if not all(one.is_as_recorded for one in shown):
        raise typer.Exit(errors.CHECK_FAILED)
