"""``minitouch-bench verify``: check a run without trusting who made it."""

import json
import secrets
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.progress import Progress

from minitouch_bench.cli import options
from minitouch_bench.cli.consoles import data_console, notes
from minitouch_bench.errors import InterruptedRunError
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.evaluation.engine import Engine, EngineOptions, open_engine
from minitouch_bench.policies.isolation.options import Isolation, IsolationOptions, PolicyLimits
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.reporting import read_run
from minitouch_bench.verification.differences import Difference
from minitouch_bench.verification.recorded_run import RecordedRun, open_run
from minitouch_bench.verification.rerun import check_identity, draw_episodes, rerun
from minitouch_bench.verification.verify import Verification, replay_run
from minitouch_bench.workflows.callbacks import Callbacks
from minitouch_bench.workflows.policies import prepare_policies

CHECK_FAILED = 1
SHOWN = 10
"""Differences that are listed; the rest is counted."""


def verify(
    run: Annotated[Path, typer.Argument(help="Directory of a finished run.")],
    *,
    again: Annotated[
        int, typer.Option("--rerun", min=0, help="Also run N drawn episodes with the checkpoint.")
    ] = 0,
    policy: Annotated[
        str | None, typer.Option(help="Where the checkpoint lies now; by default where it lay.")
    ] = None,
    exploration: Annotated[
        str | None, typer.Option(help="The same of the exploration checkpoint.")
    ] = None,
    draw: Annotated[
        int | None, typer.Option(min=0, help="Seed of the draw; by default nobody can foresee it.")
    ] = None,
    workers: options.Workers = options.AUTO,
    engine: options.EngineName = "local",
    address: options.Address = None,
    isolation: options.IsolationLevel = Isolation.SANDBOX,
    trust: options.Trust = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Replay a run's recorded actions and recompute every figure; exit 1 if any differs."""
    opening = open_engine(
        EngineOptions(engine, options.worker_count(workers), address), notes.print
    )
    setup = None
    if again:
        setup = _setup(run, policy, exploration, options.isolation_options(isolation, trust))
    seed = secrets.randbits(32) if draw is None else draw
    try:
        with opening as handle:
            opened, differences = open_run(run)
            result = Verification(0, differences)
            if opened is not None:
                result = _replay(opened, handle.engine)
                if setup is not None and result.passed:
                    result = _rerun(opened, setup, handle.engine, (again, seed), result)
    except KeyboardInterrupt as error:
        raise InterruptedRunError("interrupted; nothing was changed") from error
    if as_json:
        print(json.dumps({"passed": result.passed, "draw": seed, **asdict(result)}, indent=1))
    else:
        _show(run, result, seed)
    if not result.passed:
        raise typer.Exit(CHECK_FAILED)


def _setup(
    directory: Path, policy: str | None, exploration: str | None, isolation: IsolationOptions
) -> PolicySetup:
    """Find the run's checkpoints, see that they are the ones evaluated, and load each once."""
    header = read_run(directory).header
    limits = PolicyLimits(act_timeout_s=header.act_timeout_s)
    policy = policy or header.policy.source
    check_identity(header.policy, parse_source(policy, header.tasks, trust=isolation.trust))
    if header.exploration is not None:
        exploration = exploration or header.exploration.source
        check_identity(header.exploration, parse_source(exploration, trust=isolation.trust))
    return prepare_policies(
        policy,
        header.tasks,
        replace(isolation, limits=limits),
        Callbacks(note=notes.print),
        exploration=exploration,
    )


def _replay(run: RecordedRun, engine: Engine) -> Verification:
    with Progress(console=notes) as progress:
        bar = progress.add_task("replaying", total=len(run.specs))
        return replay_run(run, engine, lambda: progress.advance(bar))


def _rerun(
    run: RecordedRun,
    setup: PolicySetup,
    engine: Engine,
    draw: tuple[int, int],
    replayed: Verification,
) -> Verification:
    """Add what the drawn episodes gave when run with the checkpoint."""
    count, seed = draw
    specs = draw_episodes(run, count, np.random.default_rng(seed))
    found: list[Difference] = []
    with Progress(console=notes) as progress:
        bar = progress.add_task("running again", total=len(specs))
        for _, differences in rerun(run, setup, specs, engine):
            found += differences
            progress.advance(bar)
    return replace(replayed, differences=tuple(found), reran=len(specs))


def _show(directory: Path, result: Verification, seed: int) -> None:
    console = data_console()

    def line(text: str, style: str = "") -> None:
        console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)

    for difference in result.differences[:SHOWN]:
        line(str(difference))
    if len(result.differences) > SHOWN:
        line(f"... and {len(result.differences) - SHOWN} more")
    if result.episodes:
        line(f"{result.episodes} episodes replayed from their recorded actions")
    if result.reran:
        line(f"{result.reran} episodes run again with the checkpoint (--draw {seed})")
    if result.passed:
        line(f"{directory} is verified: every figure is what its episodes give", "bold green")
    else:
        line(f"{directory} is not verified", "bold red")
