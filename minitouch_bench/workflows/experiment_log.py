"""Send a finished run to an experiment tracker: figures per task, and a row per episode."""

from collections.abc import Iterator
from math import isnan
from pathlib import Path

from minitouch_bench.documents import plain
from minitouch_bench.errors import InfrastructureError, UsageError
from minitouch_bench.files import TENSORBOARD, make_folder
from minitouch_bench.optional import require
from minitouch_bench.policies.wire import describe
from minitouch_bench.reporting.frames import episodes_frame
from minitouch_bench.runs.run import Run

PROJECT = "minitouch-bench"

TRACKERS = {"wandb": ("wandb", "wandb"), "tensorboard": ("tensorboardX", "train")}
"""The package of each tracker, and the extra that brings it."""


def check_tracker(name: str) -> None:
    """See that a tracker can be used, before an hour of episodes.

    Raises:
        UsageError: there is none of that name.
        MissingExtraError: its package is not installed.
    """
    if name not in TRACKERS:
        raise UsageError(f"no tracker '{name}'; --log is {' or '.join(TRACKERS)}")
    require(*TRACKERS[name])


def log_run(name: str, run: Run, directory: Path) -> None:
    """Log a run that is finished and saved in ``directory``.

    Raises:
        InfrastructureError: the tracker failed; the run is kept.
    """
    try:
        if name == "wandb":
            _to_wandb(run)
        else:
            _to_tensorboard(run, directory)
    except Exception as error:  # whatever a tracker raises
        raise InfrastructureError(
            f"the run is finished and kept in {directory}, but {name} failed: {describe(error)}\n"
            "The same command with --resume logs it again"
        ) from error


def _figures(run: Run) -> Iterator[tuple[str, float]]:
    """Walk through the estimates with their ends, by task and metric."""
    for summary in run.summary.tasks:
        for metric, found in summary.estimates.items():
            yield f"{summary.task}/{metric}", found.value
            yield f"{summary.task}/{metric}_low", found.low
            yield f"{summary.task}/{metric}_high", found.high


def _to_wandb(run: Run) -> None:
    wandb = require(*TRACKERS["wandb"])
    settings = plain(run.header)
    with wandb.init(project=PROJECT, name=run.name, job_type="evaluate", config=settings) as logged:
        logged.summary.update(dict(_figures(run)))
        logged.log({"episodes": wandb.Table(dataframe=episodes_frame(run.episodes))})


def _to_tensorboard(run: Run, directory: Path) -> None:
    """Write events: a task's figures at step 0, an episode's at its index."""
    library = require(*TRACKERS["tensorboard"])
    frame = episodes_frame(run.episodes)
    measured = frame.select_dtypes(["number", "bool"]).drop(columns=["index", "seed"]).astype(float)
    with library.SummaryWriter(str(make_folder(directory / TENSORBOARD))) as writer:
        for tag, value in _figures(run):
            writer.add_scalar(tag, value, 0)
        for column in measured:
            for task, index, value in zip(
                frame["task"], frame["index"], measured[column], strict=True
            ):
                if not isnan(value):  # what an episode lacks
                    writer.add_scalar(f"{task}/episodes/{column}", value, index)
