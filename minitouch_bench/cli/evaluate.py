"""``minitouch-bench evaluate``: the main job."""

from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli import options
from minitouch_bench.cli.console import EpisodeProgress, data_console, notes
from minitouch_bench.conditions import CHANGES, SENSES, parse_conditions
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.protocol.minitouch import ACT_TIMEOUT_S, EPISODE_TIMEOUT_S, PROTOCOL

FINISHED_WITH_FAULTS = 4


def evaluate(
    context: typer.Context,
    policy: Annotated[str, typer.Argument(metavar="POLICY", help=options.POLICIES)],
    *,
    config: options.Config = None,  # noqa: ARG001  its callback reads it before the others
    name: Annotated[
        str | None, typer.Option(metavar="TEXT", help="What reports call the policy.")
    ] = None,
    suite: Annotated[
        str, options.episodes_option(help=f"{', '.join(s.name for s in PROTOCOL.suites)}.")
    ] = PROTOCOL.suites[0].name,
    tasks: Annotated[
        str | None, options.episodes_option(metavar="A,B", help="Only these tasks of the suite.")
    ] = None,
    exploration: options.Exploration = None,
    episodes: Annotated[
        int | None, options.episodes_option(min=1, max=MAX_EPISODES, help="Episodes per task.")
    ] = None,
    episodes_from: Annotated[
        list[str] | None,
        options.episodes_option(
            metavar="TASK/N,N",
            help="Only these episodes, as in pushing/3,17: may be given again; unofficial.",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        options.episodes_option(min=0, help="In place of the suite's own: an unofficial run."),
    ] = None,
    without: Annotated[
        str,
        options.episodes_option(
            metavar="A,B",
            help=f"Senses that stay as at the reset: {', '.join(SENSES)}. Unofficial.",
        ),
    ] = "",
    perturb: Annotated[
        str,
        options.episodes_option(
            metavar="A=X,B=X:Y", help=f"{', '.join(CHANGES)}: see docs/conditions.md. Unofficial."
        ),
    ] = "",
    output: Annotated[
        Path | None,
        options.output_option(
            metavar="DIR", help="The run's directory; by default reports/POLICY-SUITE."
        ),
    ] = None,
    video: Annotated[
        int, options.output_option(min=0, help="Film the first N episodes of each task.")
    ] = 0,
    log: Annotated[
        str | None,
        options.output_option(
            metavar="wandb|tensorboard", help="Send the figures and the episodes to a tracker."
        ),
    ] = None,
    resume: options.Resume = False,
    fresh: options.Fresh = False,
    as_json: Annotated[
        bool, options.output_option("--json", help="Print run.json in place of the tables.")
    ] = False,
    workers: options.Workers = options.AUTO,
    engine: options.EngineName = "local",
    address: options.Address = None,
    isolation: options.IsolationLevel = Isolation.SANDBOX,
    trust: options.Trust = False,
    act_timeout: options.ActTimeout = ACT_TIMEOUT_S,
    episode_timeout: options.EpisodeTimeout = EPISODE_TIMEOUT_S,
) -> None:
    """Run a policy through a suite and write its Table-4 report."""
    from minitouch_bench.evaluation.engine import EngineOptions
    from minitouch_bench.reporting.run_directory import run_json
    from minitouch_bench.reporting.writers import show_report
    from minitouch_bench.workflows import evaluate as workflow

    asked = workflow.EvaluateOptions(
        policy,
        suite=suite,
        tasks=None if tasks is None else options.comma_separated(tasks),
        episodes=episodes,
        seed=seed,
        episodes_from=tuple(episodes_from or ()),
        exploration=exploration,
        name=name,
        conditions=parse_conditions(
            options.comma_separated(without), options.comma_separated(perturb)
        ),
        engine=EngineOptions(engine, options.worker_count(workers), address),
        isolation=options.isolation_options(isolation, trust, act_timeout, episode_timeout),
        output=workflow.OutputOptions(
            output,
            resume=resume,
            fresh=fresh,
            video=video,
            log=log,
            settings=options.settings_used(context),
        ),
    )
    with EpisodeProgress(notes) as progress:
        done = workflow.evaluate(asked, progress.callbacks)
    if as_json:
        print(run_json(done.saved).decode(), end="")
    else:
        show_report(done.report, data_console())
    assert done.directory is not None
    notes.print(f"report: {done.directory / 'report.html'}", markup=False)
    if done.saved.faults:
        raise typer.Exit(FINISHED_WITH_FAULTS)
