"""The Python front door: ``import minitouch_bench as mt`` gives these names."""

from pathlib import Path
from typing import Any

import gymnasium

from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.runs.run import read_run
from minitouch_bench.tasks.objects import Objects
from minitouch_bench.workflows.evaluate import evaluate
from minitouch_bench.workflows.options import StrPath
from minitouch_bench.workflows.report import compare
from minitouch_bench.workflows.results import Run, TaskResult
from minitouch_bench.workflows.train import train

__all__ = ["Run", "TaskResult", "compare", "evaluate", "load_run", "make", "train"]


def make(task: str, objects: Objects | None = None, **options: Any) -> gymnasium.Env[Any, Any]:
    """Return the Gymnasium environment of a task, named as on the command line.

    ``objects``: "cube", a split of the shape set ("train", "held-out", "all"), names of shapes,
    shapes of a set, or a whole set of your own; by default the task's. The other options are
    those of ``gymnasium.make``, such as ``render_mode="rgb_array"``.

    Raises:
        UsageError: the task or the objects do not exist.
    """
    return gymnasium.make(PROTOCOL.task(task).gym_id, objects=objects, **options)


def load_run(path: StrPath) -> Run:
    """Read a finished run from its directory.

    Raises:
        RunDirectoryError: the directory is not a run, or is damaged.
    """
    return Run(read_run(Path(path)))
