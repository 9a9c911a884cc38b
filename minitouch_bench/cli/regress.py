"""``minitouch-bench regress``: the gate that stops a change for the worse."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from minitouch_bench.cli.console import EpisodeProgress, data_console, notes
from minitouch_bench.errors import UsageError
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.protocol.minitouch import ACT_TIMEOUT_S, EPISODE_TIMEOUT_S
from minitouch_bench.workflows import options

if TYPE_CHECKING:
    from minitouch_bench.regression.settings import GateSettings

CONFIG_FILE = "minitouch-bench.toml"
"""Read if it lies in the working directory."""

GITHUB_SUMMARY = "GITHUB_STEP_SUMMARY"
"""The variable in which a GitHub workflow names the file of a step's summary."""


def regress(
    policy: Annotated[
        str | None,
        typer.Argument(
            metavar="[POLICY]",
            help="Play this policy on the baseline's episodes, until the answer is certain.",
        ),
    ] = None,
    *,
    baseline: Annotated[Path, typer.Option(help="Directory of the run to hold on to.")],
    candidate: Annotated[
        Path | None, typer.Option(help="Directory of a finished run, in place of POLICY.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help=f"Tolerance and level; by default {CONFIG_FILE}.")
    ] = None,
    metric: Annotated[
        str | None,
        typer.Option(help="What decides: the mean of this over its tasks; by default success."),
    ] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(help="How much worse it may get, such as 0.05 or 10%; by default 0.05."),
    ] = None,
    alpha: Annotated[
        float | None, typer.Option(help="Chance of a false regression; by default 0.05.")
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Always fail where there are not enough episodes.")
    ] = False,
    lenient: Annotated[
        bool, typer.Option("--lenient", help="Never fail where there are not enough episodes.")
    ] = False,
    workers: options.WorkersText = options.AUTO,
    engine: options.EngineName = "local",
    address: options.Address = None,
    output: Annotated[
        Path | None,
        typer.Option(help="POLICY: its run's directory; by default reports/POLICY-SUITE-regress."),
    ] = None,
    resume: options.Resume = False,
    fresh: options.Fresh = False,
    isolation: options.IsolationText = Isolation.SANDBOX,
    trust: options.Trust = False,
    act_timeout: options.ActTimeout = ACT_TIMEOUT_S,
    episode_timeout: options.EpisodeTimeout = EPISODE_TIMEOUT_S,
    junit: Annotated[Path | None, typer.Option(help="Write JUnit XML there.")] = None,
    summary: Annotated[
        Path | None,
        typer.Option(help=f"Append Markdown there; by default to ${GITHUB_SUMMARY}, if set."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as JSON in place of the tables.")
    ] = False,
) -> None:
    """Say whether a candidate is worse: regression (exit 1), no regression, not enough episodes."""
    if (policy is None) == (candidate is None):
        raise UsageError("regress takes either POLICY or --candidate RUN beside --baseline")
    if candidate is not None and (output is not None or resume or fresh or trust):
        raise UsageError("--output, --resume, --fresh and --trust are for a POLICY")
    from minitouch_bench.regression.settings import with_flags
    from minitouch_bench.regression.writers import gate_json, show_result
    from minitouch_bench.workflows import regress as workflow

    page = summary or Path(os.environ.get(GITHUB_SUMMARY) or "")
    asked = workflow.RegressOptions(
        baseline,
        policy,
        candidate,
        with_flags(
            _file_settings(config),
            metric=metric,
            tolerance=tolerance,
            alpha=alpha,
            strict=strict,
            lenient=lenient,
        ),
        options.engine_options(engine, workers, address),
        options.isolation_options(isolation, trust, act_timeout, episode_timeout),
        output,
        resume,
        fresh,
        junit,
        page if page.name else None,
    )
    with EpisodeProgress(notes) as progress:
        result = workflow.regress(asked, progress.callbacks)
    if as_json:
        print(gate_json(result), end="")
    else:
        show_result(result, data_console())
    if result.exit_code:
        raise typer.Exit(result.exit_code)


def _file_settings(config: Path | None) -> "GateSettings":
    """Read the file that was named, or the one that lies here."""
    from minitouch_bench.regression.settings import STANDARD, read_settings

    file = config or Path(CONFIG_FILE)
    return STANDARD if config is None and not file.is_file() else read_settings(file)
