"""``minitouch-bench regress``: exit code 1 where a policy is worse than a baseline."""

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from minitouch_bench.commands import options
from minitouch_bench.commands.options import argument, flag, option, output_option
from minitouch_bench.console import data_console, episode_progress, note
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.evaluation.engine import AUTO
from minitouch_bench.files import append_bytes, lock_directory, write_file
from minitouch_bench.policies.policy import SANDBOXED, Isolation, isolation_options
from minitouch_bench.protocol.limits import USUAL_LIMITS

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from minitouch_bench.evaluation.engine import Engine
    from minitouch_bench.evaluation.policy_setup import PolicySetup
    from minitouch_bench.runs.run import Run

GITHUB_SUMMARY = "GITHUB_STEP_SUMMARY"
"""The variable in which a GitHub workflow names the file of a step's summary."""


def regress(
    policy: Annotated[
        str | None, argument("POLICY", "Play this policy on the baseline's episodes.")
    ] = None,
    *,
    baseline: Annotated[
        list[Path],
        option("RUN", "Directory of the run to compare with; repeat it, see --candidate."),
    ],
    candidate: Annotated[
        list[Path] | None,
        option("RUN", "A run in place of POLICY; repeat both for the training seeds of a method."),
    ] = None,
    metric: Annotated[
        str,
        option("NAME", "Its mean over tasks decides; by default success, in Playing touch_share."),
    ] = "",
    tolerance: Annotated[
        str | None,
        option("X|X%", "How much worse it may get, as 0.05 or 10%; the default is the metric's."),
    ] = None,
    alpha: Annotated[
        float | None,
        option("X", "Chance of a false regression, 0.001 to 0.25; by default that of every test."),
    ] = None,
    strict: Annotated[bool, flag("--strict", "Fail if there are not enough episodes.")] = False,
    lenient: Annotated[bool, flag("--lenient", "Pass if there are not enough episodes.")] = False,
    workers: options.Workers = AUTO,
    engine: options.EngineName = "local",
    address: options.Address = None,
    output: Annotated[
        Path | None,
        output_option("DIR", "Directory of its run; by default that of evaluate, with -regress."),
    ] = None,
    resume: options.Resume = False,
    fresh: options.Fresh = False,
    isolation: options.IsolationLevel = Isolation.SANDBOX.value,
    trust: options.Trust = False,
    act_timeout: options.ActTimeout = USUAL_LIMITS.act_timeout_s,
    episode_timeout: options.EpisodeTimeout = USUAL_LIMITS.episode_timeout_s,
    junit: Annotated[Path | None, output_option("FILE", "Write JUnit XML to this file.")] = None,
    summary: Annotated[
        Path | None,
        output_option(
            "FILE",
            "Append Markdown to this file; by default to $GITHUB_STEP_SUMMARY, if set.",
            envvar=GITHUB_SUMMARY,
            show_envvar=False,
        ),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Say whether a candidate is worse: regression (exit 1), no regression, not enough episodes.

    A policy plays the baseline's episodes; its run is kept in its directory.
    """
    from minitouch_bench.comparison import gate, gate_report, pairing
    from minitouch_bench.comparison.training_seeds import judge
    from minitouch_bench.evaluation.engine import open_engine
    from minitouch_bench.evaluation.policy_setup import prepare_policies
    from minitouch_bench.runs.run import read_run
    from minitouch_bench.verification.static_check import refuse_edited

    candidates = candidate or []
    isolated = isolation_options(isolation, trust, act_timeout, episode_timeout)
    chosen = (output, workers, engine, address, isolated) != (None, AUTO, "local", None, SANDBOXED)
    _refuse_contradictions(policy, baseline, candidates, is_played=resume or fresh or chosen)
    allowed = None if tolerance is None else gate.Tolerance.parse(tolerance)
    level = gate.GateSettings.alpha if alpha is None else alpha
    settings = gate.GateSettings(level, metric, allowed, strict, lenient)
    befores = [refuse_edited(read_run(path)) for path in baseline]
    afters = [refuse_edited(read_run(path)) for path in candidates]
    if policy is not None:
        (before,) = befores
        opening = open_engine(engine, workers, address)
        if before.exploration_rows:
            note("the baseline's exploration episodes are left out: POLICY has none")
            before = pairing.without_exploration(before)
        gate.judge_runs(before, before, ("", ""), settings)  # what cannot be judged is not played
        plan = replace(before.plan, limits=isolated.limits)
        setup = prepare_policies(policy, plan, isolated, note)
        after = _play(setup, before, output, opening, resume=resume, fresh=fresh)
        assert after.directory is not None
        befores, afters, candidates = [before], [after], [after.directory]
    paths = [[str(path) for path in of_side] for of_side in (baseline, candidates)]
    result = judge((befores, afters), paths, settings)
    if as_json:
        print(gate_report.gate_json(result), end="")
    else:
        gate_report.show_result(result, data_console())
    if junit is not None:
        write_file(junit, gate_report.gate_junit(result))
    if summary is not None:
        _append_summary(summary, gate_report.gate_markdown(result))
    if result.exit_code:
        raise typer.Exit(result.exit_code)
    if result.decision.is_open and lenient:
        note(f"warning: {result.decision.value} to decide; --lenient lets it pass", "bold yellow")


def _refuse_contradictions(
    policy: str | None, baselines: list[Path], candidates: list[Path], *, is_played: bool
) -> None:
    if (policy is None) == (not candidates):
        raise UsageError("regress takes either POLICY or --candidate RUN beside --baseline")
    if policy is not None and len(baselines) > 1:
        raise UsageError("POLICY is one training: evaluate several, and give them by --candidate")
    if candidates and is_played:
        raise UsageError("--output, --resume, --fresh and options of playing need a POLICY")


def _play(
    setup: "PolicySetup",
    baseline: "Run",
    output: Path | None,
    opening: "AbstractContextManager[Engine]",
    *,
    resume: bool,
    fresh: bool,
) -> "Run":
    """Play a policy on the baseline's episodes, and keep its run with a report."""
    from minitouch_bench.evaluation import execution
    from minitouch_bench.reporting.report import write_views
    from minitouch_bench.runs.run import Run
    from minitouch_bench.verification.static_check import refuse_edited

    header = execution.header_of(setup)
    directory = output or execution.default_directory(header, "-regress")
    there = baseline.directory
    if there is not None and directory.is_dir() and directory.samefile(there):
        raise UsageError(f"{directory} holds the baseline; choose another --output")
    with episode_progress() as callbacks, opening as engine, lock_directory(directory):
        opened = execution.open_run(header, directory, resume=resume, fresh=fresh)
        if isinstance(opened, Run) and not refuse_edited(opened).header.policy.is_code_known:
            raise UsageError(
                f"{directory} holds a finished run of {header.policy.name}, whose code can be "
                "another one now: it has no digest.\n"
                "Give --fresh in place of --resume to play it again"
            )
        run = execution.play_run(setup, opened, engine, callbacks)
        with execution.resumable(directory):
            write_views(run, directory)
    return run


def _append_summary(file: Path, text: str) -> None:
    """Append to a file; one that GitHub's variable names decides nothing if it cannot be written.

    Raises:
        RunDirectoryError: the user named the file, and it cannot be written.
    """
    try:
        append_bytes(file, text.encode())
    except RunDirectoryError as error:
        if str(file) != os.environ.get(GITHUB_SUMMARY):
            raise
        note(str(error))
