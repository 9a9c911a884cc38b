"""The Python front door: ``import minitouch_bench as mt`` gives these names."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import gymnasium

from minitouch_bench import files
from minitouch_bench.comparison.comparison import Comparison, compare_runs, comparison_html
from minitouch_bench.comparison.training_seeds import MethodComparison, compare_method_runs
from minitouch_bench.console import episode_progress, is_watched, training_progress
from minitouch_bench.errors import InterruptedRunError, UsageError
from minitouch_bench.evaluation.engine import AUTO, SILENT, Callbacks, open_engine, stopping_after
from minitouch_bench.evaluation.execution import (
    default_directory,
    header_of,
    open_run,
    play_run,
    resumable,
)
from minitouch_bench.evaluation.policy_setup import prepare_policies
from minitouch_bench.json_io import StrPath, Words, checked, take_table, words
from minitouch_bench.metrics.summary import TaskResult
from minitouch_bench.perturbation import parse_perturbation
from minitouch_bench.policies.policy import Isolation, isolation_options
from minitouch_bench.protocol.limits import ACT_TIMEOUT_S, EPISODE_TIMEOUT_S
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.reporting.report import write_views
from minitouch_bench.reporting.viewer import EpisodePage, episode_page
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.runs.run import Run, read_run
from minitouch_bench.shapegen.manifest import Objects
from minitouch_bench.verification.filming import film_run, replay_episode, require_video

if TYPE_CHECKING:
    from minitouch_bench.verification.export import Export
else:
    Export = object  # its module imports torch

__all__ = [
    "Run", "TaskResult", "compare", "compare_methods", "evaluate", "export", "load_run", "make",
    "replay", "train",
]  # fmt: skip

AUTO_OUTPUT = "auto"
"""Means the directory that the command line takes by default."""

TRAININGS = files.REPORTS / "training"


@checked
def make(
    task: str,
    objects: Objects | None = None,
    render_mode: str | None = None,
    *,
    width: int = 240,
    height: int = 240,
    max_episode_steps: int | None = None,
    disable_env_checker: bool | None = None,
) -> gymnasium.Env[Any, Any]:
    """Return the Gymnasium environment of a task, named as on the command line.

    ``objects``: "cube", a split of the shape set ("train", "held-out", "all"), names of shapes,
    shapes of a set, or a whole set of your own or its folder; by default the task's.
    ``render_mode="rgb_array"`` draws for people, ``width`` x ``height`` pixels.
    ``max_episode_steps``: by default the task's 200.

    Raises:
        UsageError: there is no such task, or there are no such objects.
    """
    if max_episode_steps is not None and max_episode_steps < 1:
        raise UsageError("max_episode_steps is a number from 1 on")
    return gymnasium.make(
        PROTOCOL.task(task).gym_id,
        max_episode_steps,
        disable_env_checker,
        objects=objects,
        render_mode=render_mode,
        width=width,
        height=height,
    )


@checked
def evaluate(
    policy: object,
    suite: str = PROTOCOL.suites[0].name,
    *,
    name: str | None = None,
    tasks: Words | None = None,
    exploration: object | None = None,
    episodes: int | None = None,
    episodes_from: str | Sequence[str] = (),
    seed: int | None = None,
    objects: Objects | None = None,
    without: Words | None = None,
    perturb: Words | None = None,
    output: StrPath | None = None,
    video: int = 0,
    replays: int = 0,
    resume: bool = False,
    fresh: bool = False,
    workers: int | str | None = AUTO,
    stop_after: float | None = None,
    engine: str = "local",
    address: str | None = None,
    isolation: str = Isolation.SANDBOX.value,
    trust: bool = False,
    act_timeout: float = ACT_TIMEOUT_S,
    episode_timeout: float = EPISODE_TIMEOUT_S,
    progress: bool | None = None,
    callbacks: Callbacks = SILENT,
) -> Run:
    """Run a policy through a suite, and keep the run in a directory if one is given.

    ``policy`` and ``exploration`` are what the command line takes, or objects: anything with
    ``act(observation)``, and ``reset(seed, task)`` if it uses episodes; a Stable-Baselines3 model;
    a torch module on (image, touch). An object runs beside the simulator, so the run is
    unofficial. Without ``output`` the run is kept in memory only, and is lost if interrupted;
    "auto" means the command line's default. ``objects`` are what ``make`` takes. ``progress`` is
    shown on stderr, or in the notebook; None: where a terminal or a notebook is attached and no
    ``callbacks`` are given. ``stop_after``: seconds. The other options are those of the command
    line.

    Raises:
        MiniTouchError: what is wrong and what to do; see ``minitouch_bench.errors``.
    """
    if output is None and (resume or fresh or video or replays):
        raise UsageError("resume, fresh, video and replays need a directory: give an output")
    if min(video, replays) < 0:
        raise UsageError("video and replays are 0 or more")
    if video:
        require_video()
    opening = open_engine(engine, workers, address)
    isolated = isolation_options(isolation, trust, act_timeout, episode_timeout)
    plan = make_plan(
        suite,
        None if tasks is None else words(tasks),
        episodes,
        seed,
        (episodes_from,) if isinstance(episodes_from, str) else episodes_from,
        conditions=parse_perturbation(words(without), words(perturb)),
        limits=isolated.limits,
        objects=objects,
    )
    with _shown(progress, callbacks, episode_progress) as shown:
        told = stopping_after(stop_after, shown)
        setup = prepare_policies(
            policy, plan, isolated, told.note, exploration=exploration, name=name
        )
        header = header_of(setup)
        directory = None if output is None else Path(output)
        if output == AUTO_OUTPUT:
            directory = default_directory(header)
        locked = files.lock_directory(directory) if directory else nullcontext()
        with opening as running, locked:
            if directory and resume and not (fresh or files.holds_run(directory)):
                told.note(f"no run to resume in {directory}: starting a new one")
            opened = open_run(header, directory, resume=resume, fresh=fresh)
            run = play_run(setup, opened, running, told)
            if directory:
                with resumable(directory):
                    films = {"videos": video, "replays": replays, "workers": running.workers}
                    write_views(run, directory, film_run(run, directory, callbacks=told, **films))
    return run


def _shown(
    progress: bool | None,
    callbacks: Callbacks,
    bars: Callable[[], AbstractContextManager[Callbacks]],
) -> AbstractContextManager[Callbacks]:
    """Return the context of the callbacks: those given, or ``bars`` where they are to be shown."""
    is_silent = callbacks is SILENT
    if progress and not is_silent:
        raise UsageError("progress shows what callbacks are told: give one of them")
    is_shown = (is_watched() and is_silent) if progress is None else progress
    return bars() if is_shown else nullcontext(callbacks)


@checked
def export(module: object, path: StrPath, task: str) -> Export:
    """Export a torch module on (image, touch) as a .pt2 file that acts like it.

    Module and file play an episode of the task side by side; ``print`` what is returned. The file
    is written only if their actions differ by at most 1e-5. The module is exported as it evaluates
    (``eval()``), on the CPU.

    Raises:
        UsageError: no such task, not a torch module, or a file name without .pt2.
        PolicyLoadError: the module cannot be exported or fails in the episode, or the file acts
            differently; the text names the state that the export has lost.
    """
    from minitouch_bench.verification.export import export_module  # noqa: PLC0415  imports torch

    return export_module(module, Path(path), task)


@checked
def compare(
    *runs: Run | StrPath, output: StrPath | None = None, html: StrPath | None = None
) -> Comparison:
    """Compare runs, or their directories, episode by episode, each with the first one.

    With ``output`` comparison.md and comparison.json are written to this directory, with ``html``
    this file is written, a page that opens offline.

    Raises:
        UsageError: the runs have other episodes or another protocol.
        RunDirectoryError: a directory is not a run, or is damaged.
    """
    opened = [_opened(run) for run in runs]
    comparison = compare_runs(opened, [run.place for run in opened])
    if output is not None:
        comparison.write(Path(output))
    if html is not None:
        files.write_file(Path(html), comparison_html(comparison, opened))
    return comparison


@checked
def compare_methods(
    a: Sequence[Run | StrPath], b: Sequence[Run | StrPath], *, output: StrPath | None = None
) -> MethodComparison:
    """Compare two methods by a run of each of their training seeds, two or more of each.

    ``output``: as in ``compare``.

    Raises:
        UsageError: a method has one run, or the runs have other episodes or another protocol.
        RunDirectoryError: a directory is not a run, or is damaged.
    """
    first, second = ([_opened(run) for run in side] for side in (a, b))
    paths = [[run.place for run in side] for side in (first, second)]
    comparison = compare_method_runs((first, second), paths)
    if output is not None:
        comparison.write(Path(output))
    return comparison


@checked
def load_run(path: StrPath) -> Run:
    """Read a finished run from its directory.

    Raises:
        RunDirectoryError: the directory is not a run, or is damaged.
    """
    return read_run(Path(path))


@checked
def replay(run: Run | StrPath, episode: str) -> EpisodePage:
    """Replay an episode of a run, called as "pushing/17", without its policy.

    A notebook shows the page that is returned; ``save`` writes it.

    Raises:
        UsageError: the run has no such episode, or cannot be replayed here.
        RunDirectoryError: the actions are missing, or their file is missing or damaged.
    """
    return episode_page(replay_episode(_opened(run), episode))


def _opened(run: Run | StrPath) -> Run:
    return run if isinstance(run, Run) else read_run(Path(run).expanduser())


@checked
def train(
    task: str,
    method: str | None = None,
    *,
    seed: int | None = None,
    exploration_steps: int | None = None,
    task_steps: int | None = None,
    objects: StrPath | None = None,
    without: Words | None = None,
    task_without: Words | None = None,
    from_log: StrPath | None = None,
    preset: str = "default",
    config: StrPath | None = None,
    settings: Mapping[str, Any] = MappingProxyType({}),
    output: StrPath | None = None,
    resume: bool = False,
    fresh: bool = False,
    device: str = "auto",
    trust: bool = False,
    progress: bool | None = None,
    callbacks: Callbacks = SILENT,
) -> Path:
    """Train a learner in two phases: curiosity alone, then the task.

    Returns the training's directory, which ``evaluate`` takes as a policy. ``settings`` change the
    preset's, nested as in the TOML file: ``{"task_phase": {"steps": 80_000}}``. ``progress``: as in
    ``evaluate``. The other options are those of the command line.

    Raises:
        MiniTouchError: what is wrong and what to do; see ``minitouch_bench.errors``.
    """
    # Not at the top: an evaluation needs neither, and no torch.
    from minitouch_bench.agents.config import TrainingConfig, make_config  # noqa: PLC0415
    from minitouch_bench.agents.training_directory import run_training  # noqa: PLC0415

    both, task_alone = words(without), words(task_without)
    given = {
        "method": method,
        "seed": seed,
        "objects": objects if isinstance(objects, str | None) else str(Path(objects).absolute()),
        "dataset": None if from_log is None else str(from_log),
        "exploration": _without_none(steps=exploration_steps, without=both or None),
        "task_phase": _without_none(steps=task_steps, without=(*both, *task_alone) or None),
    }
    base = make_config(task, preset, None if config is None else Path(config), settings)
    asked = take_table(_without_none(**given), TrainingConfig, base=base)
    directory = TRAININGS / asked.name if output is None else Path(output)
    with _shown(progress, callbacks, training_progress) as shown:
        is_done = run_training(
            asked,
            directory,
            resume=resume,
            fresh=fresh,
            device=device,
            trust=trust,
            callbacks=shown,
        )
    if not is_done:
        raise InterruptedRunError(
            f"interrupted; what is learned is kept in {directory}, and the same command with "
            "--resume continues"
        )
    return directory


def _without_none(**given: Any) -> dict[str, Any]:
    return {name: value for name, value in given.items() if value is not None}
