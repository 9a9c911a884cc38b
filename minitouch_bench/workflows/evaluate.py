"""Evaluate a policy on a suite: the command ``evaluate``, and ``minitouch_bench.evaluate``."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from minitouch_bench.conditions import CHANGES, SENSES, parse_conditions
from minitouch_bench.errors import UsageError
from minitouch_bench.files import MAX_EPISODES, REPORTS, holds_run, lock_directory
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.protocol.minitouch import ACT_TIMEOUT_S, EPISODE_TIMEOUT_S, PROTOCOL
from minitouch_bench.workflows import SILENT, Callbacks, options
from minitouch_bench.workflows.options import StrPath, Words, episodes_option, output_option

if TYPE_CHECKING:
    from minitouch_bench.workflows.results import Run

AUTO_OUTPUT = "auto"
"""Stands for ``reports/POLICY-SUITE``."""


def evaluate(
    policy: options.Policy,
    suite: Annotated[
        str, episodes_option(help=f"{', '.join(s.name for s in PROTOCOL.suites)}.")
    ] = PROTOCOL.suites[0].name,
    *,
    name: Annotated[str | None, episodes_option(metavar="TEXT")] = None,
    tasks: Annotated[Words | None, episodes_option(metavar="A,B")] = None,
    exploration: options.Exploration = None,
    episodes: Annotated[int | None, episodes_option(min=1, max=MAX_EPISODES)] = None,
    episodes_from: Annotated[Sequence[str], episodes_option(metavar="TASK/N,N")] = (),
    seed: Annotated[int | None, episodes_option(min=0)] = None,
    without: Annotated[
        Words | None,
        episodes_option(
            metavar="A,B",
            help=f"Senses that stay as at the reset: {', '.join(SENSES)}; unofficial.",
        ),
    ] = None,
    perturb: Annotated[
        Words | None,
        episodes_option(
            metavar="A=X,B=X:Y",
            help=f"{', '.join(CHANGES)}: see docs/how-to/robustness.md; unofficial.",
        ),
    ] = None,
    output: Annotated[StrPath | None, output_option(metavar="DIR")] = None,
    video: Annotated[int, output_option(min=0)] = 0,
    resume: options.Resume = False,
    fresh: options.Fresh = False,
    workers: options.Workers = options.AUTO,
    engine: options.EngineName = "local",
    address: options.Address = None,
    isolation: options.IsolationLevel = Isolation.SANDBOX,
    trust: options.Trust = False,
    act_timeout: options.ActTimeout = ACT_TIMEOUT_S,
    episode_timeout: options.EpisodeTimeout = EPISODE_TIMEOUT_S,
    callbacks: Callbacks = SILENT,
) -> "Run":
    """Run a policy through a suite and write its Table-4 report.

    In Python ``policy`` and ``exploration`` can also be objects: anything with
    ``act(observation)``, and ``reset(seed, task)`` if it uses episodes; a Stable-Baselines3 model;
    a torch module on (image, touch). An object runs beside the simulator, so the run is
    unofficial. Without ``output`` the run is kept in memory only, and is lost if interrupted.

    Args:
        name: Name of the policy in reports.
        tasks: Only these tasks of the suite; unofficial.
        episodes: Episodes per task; another number than the suite's is unofficial.
        episodes_from: Only these episodes, as in pushing/3,17; repeat it for several tasks;
            unofficial.
        seed: Seed in place of the suite's; unofficial.
        output: Directory of the run; auto: reports/POLICY-SUITE.
        video: Record videos of the first N episodes of each task.

    Raises:
        MiniTouchError: what is wrong and what to do; see ``minitouch_bench.errors``.
    """
    # Not at the top: the simulator and scipy take a second, and --help shall not.
    from minitouch_bench.evaluation.actors import prepare_policies
    from minitouch_bench.evaluation.engine import open_engine
    from minitouch_bench.evaluation.run import RunUnderWay, header_of, open_run, run_name
    from minitouch_bench.evaluation.video import require_video
    from minitouch_bench.runs.plan import make_plan
    from minitouch_bench.workflows import playing
    from minitouch_bench.workflows.results import Run

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
    directory = Path(output)
    if directory == Path(AUTO_OUTPUT):
        directory = REPORTS / run_name(setup)
    with opening as running, lock_directory(directory):
        if resume and not holds_run(directory):
            callbacks.note(f"no run to resume in {directory}: starting a new one")
        opened = open_run(setup, directory, resume=resume, fresh=fresh)
        run = playing.play(setup, opened, running, callbacks)
        playing.write_views(run, directory, video)
    return Run(run)
