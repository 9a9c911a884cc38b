"""Episodes of a run filmed again: their viewers, videos and tables, on every core."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import partial
from itertools import groupby
from pathlib import Path

from minitouch_bench.episode import EpisodePage, EpisodeSpec, PlayedEpisode, Role
from minitouch_bench.evaluation.engine import Callbacks
from minitouch_bench.evaluation.policy_setup import Recording
from minitouch_bench.evaluation.recording import film_episode, write_video
from minitouch_bench.files import REPLAYS, VIDEOS, make_folder, view_name, write_file
from minitouch_bench.processes import core_count, run_in_workers
from minitouch_bench.reporting.viewer import episode_csv, episode_page
from minitouch_bench.runs.run import Run
from minitouch_bench.verification.replay_check import is_as_recorded
from minitouch_bench.verification.static_check import refuse_unplayable

CPU_S_PER_PICTURE = 0.02
"""Seconds of one core for a control step and its picture, for an estimate of the time."""


def show_episode(run: Run, key: str) -> EpisodePage:
    """Replay an episode of a run, called as ``pushing/17``, and return its page.

    Raises:
        UsageError: the run has no such episode, or cannot be replayed here.
        RunDirectoryError: a file of it is missing or damaged.
    """
    refuse_unplayable(run)
    spec, _ = run.find(key)
    film = film_episode(Recording.of(run, [spec]), spec)
    return episode_page(run, film, is_as_recorded=is_as_recorded(run, film.played))


def film_to_files(run: Run, job: tuple[EpisodeSpec, Iterable[Path]]) -> PlayedEpisode:
    """Replay an episode once, and write a viewer, a video or a table into each of the files.

    Raises:
        MissingExtraError: an ``.mp4`` needs the extra ``video``.
        RunDirectoryError: a file of the run is missing or damaged, or one cannot be written.
    """
    spec, paths = job
    film = film_episode(Recording.of(run, [spec]), spec)
    for path in paths:
        if path.suffix == ".html":
            is_same = is_as_recorded(run, film.played)
            episode_page(run, film, is_as_recorded=is_same).save(path)
        elif path.suffix == ".csv":
            write_file(path, episode_csv(film))
        else:
            write_video(film, path)
    return film.played


def film_run(
    run: Run,
    directory: Path,
    *,
    videos: int = 0,
    replays: int = 0,
    workers: int,
    callbacks: Callbacks,
) -> None:
    """Film episodes of each task: the first ones as ``videos``, and ``replays``, failures first.

    Raises:
        RunDirectoryError: a file cannot be written.
        InfrastructureError: an episode cannot be replayed.
    """
    jobs: dict[EpisodeSpec, list[Path]] = defaultdict(list)
    for folder, suffix, specs in (
        (VIDEOS, ".mp4", _first(run, videos)),
        (REPLAYS, ".html", _failures_first(run, replays)),
    ):
        for spec in specs:
            jobs[spec].append(make_folder(directory / folder) / view_name(spec.key, suffix))
    steps = {spec: len(run.actions_of(spec.key)) + 1 for spec in jobs}
    workers = min(workers, core_count())
    estimate = sum(steps.values()) * CPU_S_PER_PICTURE / workers
    callbacks.note(f"the report is written; filming {len(jobs)} episodes, about {estimate:.0f} s")
    callbacks.phase("filming", len(jobs))
    longest_first = sorted(jobs.items(), key=lambda job: -steps[job[0]])
    for _, played in run_in_workers(
        partial(film_to_files, run), longest_first, workers, name=lambda job: f"film {job[0].key}"
    ):
        callbacks.episode(played)


def _first(run: Run, count: int) -> Iterator[EpisodeSpec]:
    for _, specs in groupby(run.header.specs(), lambda spec: (spec.role, spec.task)):
        yield from list(specs)[:count]


def _failures_first(run: Run, count: int) -> Iterator[EpisodeSpec]:
    for task in run.tasks:
        pairs = [pair for pair in run.specs_and_rows() if pair[0].task == task]
        final = [pair for pair in pairs if pair[0].role is Role.FINAL]
        yield from (spec for spec, _ in sorted(final, key=lambda pair: pair[1].success)[:count])
