"""Play one recorded episode of a run again, without its policy."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from minitouch_bench.conditions import Conditions
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.actions import Recording
from minitouch_bench.evaluation.filming import film, film_name
from minitouch_bench.evaluation.rollout import EpisodeRunner
from minitouch_bench.files import make_folder
from minitouch_bench.records import EpisodeMetrics, EpisodeRecord
from minitouch_bench.reporting.run_directory import view_directory
from minitouch_bench.verification.recorded_run import open_run

REPLAYS = "replays"
"""Folder of the films that were made of a finished run."""


@dataclass(frozen=True)
class ReplayedEpisode:
    """An episode as its recorded actions give it here, and its row in the run."""

    run: Path
    record: EpisodeRecord
    row: EpisodeMetrics
    conditions: Conditions

    @property
    def is_same(self) -> bool:
        """Whether its bits are those that were recorded."""
        return self.record.trace.digest() == self.row.digest


def replay(run: Path, episode: str) -> ReplayedEpisode:
    """Play the episode called ``episode``, as ``pushing/17``, of a finished run again.

    Raises:
        UsageError: the run has no such episode, or cannot be replayed here.
        RunDirectoryError: it is no run, or a file of it is damaged.
    """
    opened, problems = open_run(run)
    if opened is None:
        raise UsageError(f"{run} cannot be replayed.\n{problems[0]}")
    spec, row = opened.find(episode)
    conditions = opened.saved.header.played_under
    runner = EpisodeRunner(Recording(opened.actions, conditions))
    try:
        return ReplayedEpisode(run, runner.run(spec), row, conditions)
    finally:
        runner.close()


def film_replay(replayed: ReplayedEpisode, path: Path | None = None) -> Path:
    """Film the episode into an ``.mp4`` or a ``.gif``, by default in the run's ``replays/``.

    The run of a submission has them in ``reports/``, see ``view_directory``.

    Raises:
        MissingExtraError: an ``.mp4`` needs the extra ``video``.
        UsageError: another kind of file.
        RunDirectoryError: the file cannot be written.
    """
    spec, actions = replayed.record.spec, replayed.record.trace.actions
    file = path or (
        make_folder(view_directory(replayed.run) / REPLAYS) / film_name(spec.key, _suffix())
    )
    return film(spec, actions, file, replayed.conditions)


def _suffix() -> str:
    """Return the kind of film that this installation can write."""
    return ".mp4" if find_spec("imageio_ffmpeg") and find_spec("imageio") else ".gif"
