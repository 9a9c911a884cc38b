"""Compare a candidate with its baseline, and exit 1 if it is worse: the command ``regress``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from minitouch_bench.errors import UsageError
from minitouch_bench.files import append_text, write_file
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.protocol.minitouch import ACT_TIMEOUT_S, EPISODE_TIMEOUT_S
from minitouch_bench.workflows import SILENT, Callbacks, options
from minitouch_bench.workflows.options import StrPath

if TYPE_CHECKING:
    from minitouch_bench.regression.gate import GateResult

CONFIG_FILE = "minitouch-bench.toml"
"""Read if it lies in the working directory."""

GITHUB_SUMMARY = "GITHUB_STEP_SUMMARY"
"""The variable in which a GitHub workflow names the file of a step's summary."""


def regress(
    policy: Annotated[object | None, typer.Argument(metavar="POLICY")] = None,
    *,
    baseline: Annotated[StrPath, typer.Option()],
    candidate: Annotated[StrPath | None, typer.Option()] = None,
    config: Annotated[StrPath | None, typer.Option()] = None,
    metric: Annotated[str | None, typer.Option()] = None,
    tolerance: Annotated[float | str | None, typer.Option()] = None,
    alpha: Annotated[float | None, typer.Option()] = None,
    strict: Annotated[bool, typer.Option()] = False,
    lenient: Annotated[bool, typer.Option()] = False,
    workers: options.Workers = options.AUTO,
    engine: options.EngineName = "local",
    address: options.Address = None,
    output: Annotated[StrPath | None, typer.Option()] = None,
    resume: options.Resume = False,
    fresh: options.Fresh = False,
    isolation: options.IsolationLevel = Isolation.SANDBOX,
    trust: options.Trust = False,
    act_timeout: options.ActTimeout = ACT_TIMEOUT_S,
    episode_timeout: options.EpisodeTimeout = EPISODE_TIMEOUT_S,
    junit: Annotated[StrPath | None, typer.Option()] = None,
    summary: Annotated[
        StrPath | None, typer.Option(envvar=GITHUB_SUMMARY, show_envvar=False)
    ] = None,
    callbacks: Callbacks = SILENT,
) -> "GateResult":
    """Say whether a candidate is worse: regression (exit 1), no regression, not enough episodes.

    A policy plays the baseline's episodes until the answer is certain, or all of them; its run is
    kept in its directory.

    Args:
        policy: Play this policy on the baseline's episodes, until the answer is certain.
        baseline: Directory of the run to compare with.
        candidate: Directory of a finished run, in place of POLICY.
        config: TOML file with metric, tolerance and level; by default minitouch-bench.toml.
        metric: What decides: the mean of this metric over its tasks; by default success, in
            Playing alone touch_share.
        tolerance: How much worse the metric may get, such as 0.05 or 10%; the default depends on
            the metric.
        alpha: Chance of a false regression; by default 0.05.
        strict: Always fail if there are not enough episodes.
        lenient: Never fail if there are not enough episodes.
        output: Directory of POLICY's run; by default reports/POLICY-SUITE-regress.
        junit: Write JUnit XML to this file.
        summary: Append Markdown to this file; by default to $GITHUB_STEP_SUMMARY, if set.

    Raises:
        UsageError: an option has no meaning, or the runs are not of the same episodes.
        PolicyError, IsolationError, MissingExtraError: the policy cannot be used.
        RunDirectoryError: a directory is in use, holds another run, or none.
        InfrastructureError, InterruptedRunError: the run is incomplete and can be resumed.
    """
    if (policy is None) == (candidate is None):
        raise UsageError("regress takes either POLICY or --candidate RUN beside --baseline")
    if candidate is not None and (output is not None or resume or fresh or trust):
        raise UsageError("--output, --resume, --fresh and --trust are for a POLICY")
    from minitouch_bench.regression.gate import judge_runs
    from minitouch_bench.regression.settings import STANDARD, GateFlags, read_settings, with_flags
    from minitouch_bench.regression.writers import gate_junit, gate_markdown
    from minitouch_bench.workflows.gating import play_gate, read_unedited

    file = Path(config or CONFIG_FILE)
    settings = with_flags(
        read_settings(file) if config is not None or file.is_file() else STANDARD,
        GateFlags(alpha, metric, tolerance, strict, lenient),
    )
    before = read_unedited(Path(baseline))
    if candidate is not None:
        paths = (str(baseline), str(candidate))
        result = judge_runs(before, read_unedited(Path(candidate)), paths, settings)
    else:
        result = play_gate(
            before,
            str(baseline),
            policy,
            settings,
            engine=options.engine_options(engine, workers, address),
            isolation=options.isolation_options(isolation, trust, act_timeout, episode_timeout),
            output=None if output is None else Path(output),
            resume=resume,
            fresh=fresh,
            callbacks=callbacks,
        )
    if junit is not None:
        write_file(Path(junit), gate_junit(result))
    if summary is not None:
        append_text(Path(summary), gate_markdown(result))
    return result
