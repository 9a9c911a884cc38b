"""The command ``evaluate``: run a policy through a suite, and print its Table 4."""

from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.commands import options
from minitouch_bench.commands.options import episodes_option, output_flag, output_option
from minitouch_bench.console import data_console, note
from minitouch_bench.errors import PolicyFaultError
from minitouch_bench.evaluation.engine import AUTO
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.perturbation import PERTURBATION_NAMES, SENSES
from minitouch_bench.policies.policy import Isolation
from minitouch_bench.protocol.limits import USUAL_LIMITS
from minitouch_bench.protocol.minitouch import MAIN_SUITE, SUITE_NAMES

CONDITIONS = f"{', '.join(PERTURBATION_NAMES)}: see docs/how-to/robustness.md; unofficial."
FROZEN_SENSES = f"Senses that stay as at the reset: {', '.join(SENSES)}; unofficial."


def evaluate(
    policy: options.PolicyArgument,
    *,
    suite: Annotated[str, episodes_option("NAME", f"{', '.join(SUITE_NAMES)}.")] = MAIN_SUITE,
    name: Annotated[str | None, episodes_option("TEXT", "Name of the policy in reports.")] = None,
    tasks: Annotated[
        str | None, episodes_option("A,B", "Only these tasks of the suite; unofficial.")
    ] = None,
    exploration: Annotated[
        str | None, episodes_option("POLICY", "The policy at the end of the exploration phase.")
    ] = None,
    episodes: Annotated[
        int | None,
        episodes_option(
            "N", "Episodes per task; another number is unofficial.", min=1, max=MAX_EPISODES
        ),
    ] = None,
    episodes_from: Annotated[
        list[str] | None,
        episodes_option("TASK/N,N", "Only these, as pushing/3,17; may be repeated; unofficial."),
    ] = None,
    seed: Annotated[
        int | None, episodes_option("N", "Seed in place of the suite's; unofficial.", min=0)
    ] = None,
    objects: Annotated[
        str | None, episodes_option("SET", f"{options.OBJECTS}; unofficial.")
    ] = None,
    without: Annotated[str | None, episodes_option("A,B", FROZEN_SENSES)] = None,
    perturb: Annotated[str | None, episodes_option("A=X,B=X:Y", CONDITIONS)] = None,
    output: Annotated[
        Path | None,
        output_option("DIR", "By default reports/POLICY-SUITE and what differs from the suite."),
    ] = None,
    video: Annotated[
        int, output_option("N", "Record videos of the first N episodes of each task.", min=0)
    ] = 0,
    replays: Annotated[
        int, output_option("N", "Write viewers of N episodes of each task, failures first.", min=0)
    ] = 0,
    resume: options.Resume = False,
    fresh: options.Fresh = False,
    as_json: Annotated[
        bool, output_flag("--json", "Print run.json in place of the tables.")
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
    arguments = dict(locals())  # the options are named as the arguments of ``api.evaluate``
    from minitouch_bench import api
    from minitouch_bench.reporting.report import build_report, show_report
    from minitouch_bench.runs.run import run_json

    del arguments["as_json"]
    arguments["episodes_from"] = episodes_from or ()
    arguments["output"] = output or api.AUTO_OUTPUT
    run = api.evaluate(**arguments, progress=True)
    if as_json:
        print(run_json(run).decode(), end="")
    else:
        show_report(build_report([run]), data_console())
    assert run.directory is not None
    note(f"report: {run.directory / 'report.html'}")
    if run.faults:
        raise typer.Exit(PolicyFaultError.exit_code)
