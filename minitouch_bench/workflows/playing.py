"""Play a run in its directory, and write its facts and its views."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from minitouch_bench.errors import (
    HopelessRunError,
    InfrastructureError,
    InterruptedRunError,
    RunDirectoryError,
)
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.evaluation.engine import Engine
from minitouch_bench.evaluation.run import play_missing
from minitouch_bench.evaluation.video import video_name, write_video
from minitouch_bench.files import RUN_FILE, VIDEOS, list_videos, make_folder, write_file
from minitouch_bench.reporting import writers
from minitouch_bench.runs.journal import Journal
from minitouch_bench.runs.run import Run, run_json
from minitouch_bench.workflows import Callbacks


def play(setup: PolicySetup, opened: Journal | Run, engine: Engine, callbacks: Callbacks) -> Run:
    """Play the episodes that are missing, and keep the facts of the run in its directory.

    The callbacks also receive the episodes that are already done. A finished run is returned
    unchanged.
    """
    if isinstance(opened, Run):
        callbacks.note(f"{opened.directory} contains the finished run: no episode is missing")
        return opened
    callbacks.phase("episodes", len(opened.header.specs()))
    for record in opened.records.values():
        callbacks.episode(record)
    with resumable(opened.directory):
        run = play_missing(setup, opened, engine, callbacks.episode)
        if run.directory is None:
            return run
        content = run_json(run)
        write_file(run.directory / RUN_FILE, content)  # a directory with it holds a finished run
    opened.remove()
    return replace(run, content=content)


@contextmanager
def resumable(directory: Path | None) -> Iterator[None]:
    """Tell the user of an interrupted run how to continue it.

    A file that cannot be written, as on a full disk, interrupts one too.
    """
    advice = (
        "Nothing is kept: a run with an output directory could be resumed."
        if directory is None
        else f"What is done is kept in {directory}; the same command with --resume continues."
    )
    try:
        yield
    except HopelessRunError as error:
        raise HopelessRunError(f"{error}\n{advice}") from error
    except (InfrastructureError, RunDirectoryError) as error:
        raise InfrastructureError(f"{error}\n{advice}") from error
    except KeyboardInterrupt as error:
        raise InterruptedRunError(f"interrupted\n{advice}") from error


def write_views(run: Run, directory: Path, video: int = 0) -> None:
    """Write the report, the episodes, and videos of the first ``video`` episodes of each task."""
    for spec in run.header.specs():
        if spec.index < video:
            file = make_folder(directory / VIDEOS) / video_name(spec.key)
            write_video(spec, run.actions_of(spec.key), file, run.plan.conditions)
    writers.write_views(run, directory, list_videos(directory))
