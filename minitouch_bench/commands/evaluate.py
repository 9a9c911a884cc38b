"""The command ``evaluate``: run a policy through a suite, and print its Table 4."""

from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli import options
from minitouch_bench.cli.console import data_console, note
from minitouch_bench.cli.options import episodes_option, output_option
from minitouch_bench.errors import PolicyFaultError
from minitouch_bench.evaluation.engine import AUTO
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.perturbation import PERTURBATION_NAMES, SENSES
from minitouch_bench.policies.policy import Isolation
from minitouch_bench.protocol.minitouch import MAIN_SUITE, SUITE_NAMES, USUAL_LIMITS


def evaluate(
    policy: options.PolicyArgument,
    *,
    suite: Annotated[str, episodes_option(help=f"{', '.join(SUITE_NAMES)}.")] = MAIN_SUITE,
    name: Annotated[str | None, episodes_option(help="Name of the policy in reports.")] = None,
    tasks: Annotated[
        str | None,
        episodes_option(metavar="A,B", help="Only these tasks of the suite; unofficial."),
    ] = None,
    exploration: options.Exploration = None,
    episodes: Annotated[
        int | None,
        episodes_option(
            metavar="N",
            min=1,
            max=MAX_EPISODES,
            help="Episodes per task; another number makes the run unofficial.",
        ),
    ] = None,
    episodes_from: Annotated[
        list[str] | None,
        episodes_option(
            metavar="TASK/N,N",
            help="Only these episodes, as in pushing/3,17; repeat it for several tasks; "
            "unofficial.",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        episodes_option(metavar="N", min=0, help="Seed in place of the suite's; unofficial."),
    ] = None,
    objects: Annotated[
        str | None,
        episodes_option(
            metavar="SET",
            help="Objects in place of the tasks' own, in turn: the folder of a shape set, or "
            "cube, train, held-out or all; unofficial.",
        ),
    ] = None,
    without: Annotated[
        str | None,
        episodes_option(
            metavar="A,B",
            help=f"Senses that stay as at the reset: {', '.join(SENSES)}; unofficial.",
        ),
    ] = None,
    perturb: Annotated[
        str | None,
        episodes_option(
            metavar="A=X,B=X:Y",
            help=f"{', '.join(PERTURBATION_NAMES)}: see docs/how-to/robustness.md; unofficial.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        output_option(
            metavar="DIR",
            help="Directory of the run; by default reports/POLICY-SUITE and what differs from the "
            "suite, as in reports/hac-table4-pick-up-10-episodes. Where a policy of another format "
            "has this directory, its name has the format, as in reports/hac-onnx-table4.",
        ),
    ] = None,
    video: Annotated[
        int,
        output_option(
            metavar="N", min=0, help="Record videos of the first N episodes of each task."
        ),
    ] = 0,
    replays: Annotated[
        int,
        output_option(
            metavar="N",
            min=0,
            help="Write the viewers of N episodes of each task into replays/, failures first.",
        ),
    ] = 0,
    resume: options.Resume = False,
    fresh: options.Fresh = False,
    as_json: Annotated[
        bool, output_option("--json", help="Print run.json in place of the tables.")
    ] = False,
    workers: options.Workers = AUTO,
    stop_after: options.StopAfter = None,
    engine: options.EngineName = "local",
    address: options.Address = None,
    isolation: options.IsolationLevel = Isolation.SANDBOX.value,
    trust: options.Trust = False,
    act_timeout: options.ActTimeout = USUAL_LIMITS.act_timeout_s,
    episode_timeout: options.EpisodeTimeout = USUAL_LIMITS.episode_timeout_s,
) -> None:
    """Run a policy through a suite and write its Table-4 report."""
    from minitouch_bench import api
    from minitouch_bench.reporting.report import build_report, show_report
    from minitouch_bench.runs.run import run_json

    run = api.evaluate(
        policy,
        suite,
        name=name,
        tasks=tasks,
        exploration=exploration,
        episodes=episodes,
        episodes_from=episodes_from or (),
        seed=seed,
        objects=objects,
        without=without,
        perturb=perturb,
        output=api.AUTO_OUTPUT if output is None else output,
        video=video,
        replays=replays,
        resume=resume,
        fresh=fresh,
        workers=workers,
        stop_after=options.seconds_of("--stop-after", stop_after),
        engine=engine,
        address=address,
        isolation=isolation,
        trust=trust,
        act_timeout=act_timeout,
        episode_timeout=episode_timeout,
        progress=True,
    )
    if as_json:
        print(run_json(run).decode(), end="")
    else:
        show_report(build_report([run]), data_console())
    assert run.directory is not None
    note(f"report: {run.directory / 'report.html'}")
    if run.faults:
        raise typer.Exit(PolicyFaultError.exit_code)
