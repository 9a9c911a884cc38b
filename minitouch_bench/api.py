"""The Python front door: ``import minitouch_bench as mt`` gives these names."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium

from minitouch_bench.conditions import parse_conditions
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.actors import prepare_policies
from minitouch_bench.evaluation.engine import open_engine
from minitouch_bench.evaluation.run import RunUnderWay, header_of, open_run, run_name
from minitouch_bench.evaluation.video import require_video
from minitouch_bench.files import REPORTS, holds_run, lock_directory
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.protocol.minitouch import ACT_TIMEOUT_S, EPISODE_TIMEOUT_S, PROTOCOL
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.runs.run import read_run
from minitouch_bench.tasks.objects import Objects
from minitouch_bench.workflows import SILENT, Callbacks, options, playing
from minitouch_bench.workflows.options import StrPath, Words
from minitouch_bench.workflows.report import compare
from minitouch_bench.workflows.results import Run, TaskResult
from minitouch_bench.workflows.train import train

__all__ = ["Run", "TaskResult", "compare", "evaluate", "load_run", "make", "train"]

AUTO_OUTPUT = "auto"
"""Stands for ``reports/POLICY-SUITE``."""


def make(task: str, objects: Objects | None = None, **options: Any) -> gymnasium.Env[Any, Any]:
    """Return the Gymnasium environment of a task, named as on the command line.

    ``objects``: "cube", a split of the shape set ("train", "held-out", "all"), names of shapes,
    shapes of a set, or a whole set of your own; by default the task's. The other options are
    those of ``gymnasium.make``, such as ``render_mode="rgb_array"``.

    Raises:
        UsageError: the task or the objects do not exist.
    """
    return gymnasium.make(PROTOCOL.task(task).gym_id, objects=objects, **options)


def evaluate(
    policy: object,
    suite: str = PROTOCOL.suites[0].name,
    *,
    name: str | None = None,
    tasks: Words | None = None,
    exploration: object | None = None,
    episodes: int | None = None,
    episodes_from: Sequence[str] = (),
    seed: int | None = None,
    without: Words | None = None,
    perturb: Words | None = None,
    output: StrPath | None = None,
    video: int = 0,
    resume: bool = False,
    fresh: bool = False,
    workers: int | str | None = options.AUTO,
    engine: str = "local",
    address: str | None = None,
    isolation: str = Isolation.SANDBOX.value,
    trust: bool = False,
    act_timeout: float = ACT_TIMEOUT_S,
    episode_timeout: float = EPISODE_TIMEOUT_S,
    callbacks: Callbacks = SILENT,
) -> Run:
    """Run a policy through a suite, and keep the run in a directory if one is given.

    ``policy`` and ``exploration`` are what the command line takes, or objects: anything with
    ``act(observation)``, and ``reset(seed, task)`` if it uses episodes; a Stable-Baselines3 model;
    a torch module on (image, touch). An object runs beside the simulator, so the run is
    unofficial. Without ``output`` the run is kept in memory only, and is lost if interrupted;
    "auto" stands for ``reports/POLICY-SUITE``. The other options are those of the command line.

    Raises:
        MiniTouchError: what is wrong and what to do; see ``minitouch_bench.errors``.
    """
    if output is None and (resume or fresh or video):
        raise UsageError("resume, fresh and video need a directory: give an output")
    if video:
        require_video()
    opening = open_engine(options.engine_options(engine, workers, address), callbacks.note)
    isolated = options.isolation_options(isolation, trust, act_timeout, episode_timeout)
    plan = make_plan(
        suite,
        None if tasks is None else options.words(tasks),
        episodes,
        seed,
        episodes_from or (),
        conditions=parse_conditions(options.words(without), options.words(perturb)),
        limits=isolated.limits,
    )
    setup = prepare_policies(
        policy, plan, isolated, callbacks.note, exploration=exploration, name=name
    )
    if output is None:
        with opening as running:
            return Run(playing.play(setup, RunUnderWay(header_of(setup)), running, callbacks))
    directory = REPORTS / run_name(setup) if str(output) == AUTO_OUTPUT else Path(output)
    with opening as running, lock_directory(directory):
        if resume and not holds_run(directory):
            callbacks.note(f"no run to resume in {directory}: starting a new one")
        opened = open_run(setup, directory, resume=resume, fresh=fresh)
        run = playing.play(setup, opened, running, callbacks)
        playing.write_views(run, directory, video)
    return Run(run)


def load_run(path: StrPath) -> Run:
    """Read a finished run from its directory.

    Raises:
        RunDirectoryError: the directory is not a run, or is damaged.
    """
    return Run(read_run(Path(path)))
