"""The command ``replay``: play one recorded episode of a run again, without its policy."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from minitouch_bench.cli import options
from minitouch_bench.cli.console import data_console, note
from minitouch_bench.episode import PlayedEpisode
from minitouch_bench.errors import CHECK_FAILED
from minitouch_bench.files import REPLAYS, make_folder

if TYPE_CHECKING:
    pass

STEP_HEADINGS = ("step", "action", "end effector (m)", "fingers (N)", "contact (ticks)", "object")


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
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Video file, .mp4 or .gif; by default in RUN/replays/, of a submission's run in "
            "reports/.",
        ),
    ] = None,
    steps: Annotated[
        bool, typer.Option("--steps", help="Print what happened at each step, and record no video.")
    ] = False,
) -> None:
    """Replay a recorded episode without its policy: record a video, or print it step by step."""
    from minitouch_bench.evaluation.recording import video_name, video_suffix, write_video
    from minitouch_bench.reporting.report import view_directory
    from minitouch_bench.runs.run import read_run
    from minitouch_bench.verification.replay_check import is_as_recorded, replay_episode

    opened = read_run(run)
    record = replay_episode(opened, episode)
    actions, count = record.trace.actions, len(record.trace.actions)
    if steps:
        _print_steps(record)
    else:
        note(f"recording a video of {count + 1} frames")
        folder = view_directory(opened.directory or run) / REPLAYS
        file = video or make_folder(folder) / video_name(episode, video_suffix())
        print(write_video(record.spec, actions, file, opened.plan))
    is_same = is_as_recorded(opened, record)
    bits = "the same bits as recorded" if is_same else "NOT the bits that were recorded"
    note(f"{record.spec.key}: {opened.find(episode)[1].outcome} after {count} steps; {bits}")
    if not is_same:
        raise typer.Exit(CHECK_FAILED)


def _print_steps(record: PlayedEpisode) -> None:
    """Print one row per step: the action, and what was measured after it."""
    import numpy as np
    from rich.table import Table

    from minitouch_bench.simulation.observation import FORCES, POSITION

    def numbers(values: Iterable[Any], form: str) -> str:
        return " ".join(format(float(value), form) for value in values)

    title = f"{record.spec.key}  {record.spec.shape}".rstrip()
    table = Table(*STEP_HEADINGS, title=title, title_justify="left")
    for column in table.columns:
        column.justify = "right"
    trace = record.trace
    for step, action in enumerate(trace.actions):
        touch = trace.touch[step + 1]
        left, right = np.linalg.norm(touch[FORCES].reshape(2, 3), axis=1)
        table.add_row(
            str(step),
            numbers(action, "+.2f"),
            numbers(touch[POSITION], ".3f"),
            f"{left:.1f} {right:.1f}",
            f"{trace.contact_ticks[step]} of {trace.ticks[step]}",
            numbers(trace.object_state[step + 1], ".4f"),
        )
    is_angle = trace.object_state.shape[1] == 1
    table.caption = f"object: {'door angle, rad' if is_angle else 'position, m'}"
    data_console().print(table)
