"""The command ``replay``: play one recorded episode of a run again, without its policy."""

import contextlib
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from minitouch_bench.cli import options
from minitouch_bench.cli.console import data_console, note
from minitouch_bench.episode import Episode, PlayedEpisode
from minitouch_bench.errors import CHECK_FAILED
from minitouch_bench.files import make_folder

if TYPE_CHECKING:
    from minitouch_bench.runs.run import Run

STEP_HEADINGS = ("step", "action", "end effector (m)", "fingers (N)", "contact (ticks)", "object")

REPLAYS = "replays"
"""Folder of the videos that were made of a finished run."""


@dataclass(frozen=True)
class ReplayedEpisode:
    """An episode as its recorded actions give it here, and its row in the run."""

    run: "Run"
    record: PlayedEpisode
    row: Episode

    @property
    def is_same(self) -> bool:
        """Whether its bits and its outcome are those that were recorded."""
        recorded = (self.row.digest, self.row.outcome)
        return (self.record.trace.digest(), self.record.outcome) == recorded


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
    replayed = replay_episode(run, episode)
    record, row = replayed.record, replayed.row
    count = len(record.trace.actions)
    if steps:
        _print_steps(record)
    else:
        note(f"recording a video of {count + 1} frames")
        print(write_replay_video(replayed, video))
    bits = "the same bits as recorded" if replayed.is_same else "NOT the bits that were recorded"
    note(f"{record.spec.key}: {row.outcome} after {count} steps; {bits}")
    if not replayed.is_same:
        raise typer.Exit(CHECK_FAILED)


def replay_episode(run: Path, episode: str) -> ReplayedEpisode:
    """Play an episode of a run by its recorded actions; ``episode`` is its key.

    Raises:
        UsageError: the run has no such episode, or cannot be replayed here.
        RunDirectoryError: it is not a run, or a file of it is damaged.
    """
    from minitouch_bench.evaluation.actors import Recording
    from minitouch_bench.evaluation.rollout import EpisodeRunner
    from minitouch_bench.runs.run import read_run
    from minitouch_bench.verification.static_check import refuse_unplayable

    opened = read_run(run)
    refuse_unplayable(opened)
    spec, row = opened.find(episode)
    opened.actions_of(spec.key)
    recording = Recording(opened.actions, opened.plan.conditions)
    with contextlib.closing(EpisodeRunner(recording)) as runner:
        return ReplayedEpisode(opened, runner.run(spec), row)


def write_replay_video(replayed: ReplayedEpisode, path: Path | None = None) -> Path:
    """Film the episode into an ``.mp4`` or a ``.gif``, by default in the run's ``replays/``.

    The run of a submission has them in ``reports/``, see ``view_directory``.

    Raises:
        MissingExtraError: an ``.mp4`` needs the extra ``video``.
        UsageError: another kind of file.
        RunDirectoryError: the file cannot be written.
    """
    from minitouch_bench.evaluation.video import video_name, write_video
    from minitouch_bench.reporting.report import view_directory

    spec, actions = replayed.record.spec, replayed.record.trace.actions
    run = replayed.run
    assert run.directory is not None
    file = path or (
        make_folder(view_directory(run.directory) / REPLAYS) / video_name(spec.key, _suffix())
    )
    return write_video(spec, actions, file, run.plan.conditions)


def _suffix() -> str:
    """Return the kind of video that this installation can write."""
    return ".mp4" if find_spec("imageio_ffmpeg") and find_spec("imageio") else ".gif"


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
