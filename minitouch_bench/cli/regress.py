"""``minitouch-bench regress``: the gate that stops a change for the worse."""

import os
from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli import options
from minitouch_bench.cli.consoles import data_console, notes
from minitouch_bench.cli.gating import PlaySettings, play_gate, request_like
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.engine import EngineOptions, open_engine
from minitouch_bench.files import append_text, write_file
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.regression.documents import to_text, verdict_document
from minitouch_bench.regression.gate import Verdict, judge_runs
from minitouch_bench.regression.junit import verdict_junit
from minitouch_bench.regression.markdown import verdict_markdown
from minitouch_bench.regression.terminal import show_verdict
from minitouch_bench.regression.tolerances import (
    CONFIG_FILE,
    GateSettings,
    read_settings,
    with_flags,
)
from minitouch_bench.reporting import read_run

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
        Path | None, typer.Option(help=f"Tolerances and levels; by default {CONFIG_FILE}.")
    ] = None,
    tolerance: Annotated[
        list[str] | None,
        typer.Option(help="[TASK.]METRIC=AMOUNT or =PERCENT%, for example pushing.success=0.1."),
    ] = None,
    metrics: Annotated[
        str | None, typer.Option(help="Guard only these, separated by commas.")
    ] = None,
    alpha: Annotated[
        float | None, typer.Option(help="Chance of a false regression; by default 0.05.")
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit 1 where the gate is inconclusive too.")
    ] = False,
    workers: options.Workers = options.AUTO,
    engine: options.EngineName = "local",
    address: options.Address = None,
    output: Annotated[
        Path | None,
        typer.Option(help="POLICY: its run's directory; by default reports/POLICY-SUITE-regress."),
    ] = None,
    resume: options.Resume = False,
    fresh: options.Fresh = False,
    isolation: options.IsolationLevel = Isolation.SANDBOX,
    trust: options.Trust = False,
    act_timeout: options.ActTimeout = options.ACT_TIMEOUT_S,
    junit: Annotated[Path | None, typer.Option(help="Write JUnit XML there.")] = None,
    summary: Annotated[
        Path | None,
        typer.Option(help=f"Append Markdown there; by default to ${GITHUB_SUMMARY}, if set."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the verdict as JSON in place of the table.")
    ] = False,
) -> None:
    """Exit 1 if a candidate is worse than the baseline, beyond tolerance and chance."""
    if (policy is None) == (candidate is None):
        raise UsageError("regress takes either POLICY or --candidate RUN beside --baseline")
    if candidate is not None and (output is not None or resume or fresh or trust):
        raise UsageError("--output, --resume, --fresh and --trust are for a POLICY")
    settings = with_flags(
        _file_settings(config), tolerance or (), alpha=alpha, strict=strict, metrics=metrics
    )
    known = read_run(baseline)
    if candidate is not None:
        places = (str(baseline), str(candidate))
        verdict = judge_runs(known, read_run(candidate), places, settings)
    else:
        assert policy is not None
        chosen = open_engine(
            EngineOptions(engine, options.worker_count(workers), address), notes.print
        )
        isolated = options.isolation_options(isolation, trust, act_timeout)
        request = request_like(known, policy, isolated)
        with chosen as handle:
            play = PlaySettings(output, handle, resume=resume, fresh=fresh)
            verdict = play_gate(known, str(baseline), request, settings, play)
    _report(verdict, junit, summary, as_json=as_json)
    if verdict.exit_code:
        raise typer.Exit(verdict.exit_code)


def _file_settings(config: Path | None) -> GateSettings:
    """Read the file that was named, or the one that lies here."""
    if config is not None:
        return read_settings(config)
    here = Path(CONFIG_FILE)
    return read_settings(here) if here.is_file() else GateSettings()


def _report(verdict: Verdict, junit: Path | None, summary: Path | None, *, as_json: bool) -> None:
    """Print the verdict and write what was asked for."""
    if junit is not None:
        write_file(junit, verdict_junit(verdict))
    page = summary or Path(os.environ.get(GITHUB_SUMMARY) or "")
    if page.name:
        append_text(page, verdict_markdown(verdict))
    if as_json:
        print(to_text(verdict_document(verdict)), end="")
    else:
        show_verdict(verdict, data_console())
