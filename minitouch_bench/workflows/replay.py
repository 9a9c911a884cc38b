"""Play one recorded episode of a run again, without its policy."""

import contextlib
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from minitouch_bench.files import make_folder
from minitouch_bench.records import EpisodeMetrics, EpisodeRecord
from minitouch_bench.workflows import options

if TYPE_CHECKING:
    from minitouch_bench.runs.run import Run

REPLAYS = "replays"
"""Folder of the videos that were made of a finished run."""


@dataclass(frozen=True)
class ReplayedEpisode:
    """An episode as its recorded actions give it here, and its row in the run."""

    run: "Run"
    record: EpisodeRecord
    row: EpisodeMetrics

    @property
    def is_same(self) -> bool:
        """Whether its bits and its outcome are those that were recorded."""
        recorded = (self.row.digest, self.row.outcome)
        return (self.record.trace.digest(), self.record.outcome) == recorded


def replay(
    run: options.RunDirectory,
    episode: Annotated[str, typer.Argument()],
) -> ReplayedEpisode:
    """Replay a recorded episode without its policy: record a video, or print it step by step.

    Args:
        episode: Its key, such as pushing/17 or exploration/pushing/17.

    Raises:
        UsageError: the run has no such episode, or cannot be replayed here.
        RunDirectoryError: it is not a run, or a file of it is damaged.
    """
    from minitouch_bench.evaluation.actors import Recording
    from minitouch_bench.evaluation.rollout import EpisodeRunner
    from minitouch_bench.runs.run import read_run
    from minitouch_bench.verification.static_check import refuse_unplayable

    opened = read_run(Path(run))
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
