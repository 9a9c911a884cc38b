"""``minitouch-bench verify``: check a run without trusting who made it."""

import json
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from minitouch_bench.cli import options
from minitouch_bench.cli.console import EpisodeProgress, data_console, notes
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.rendering.escaping import printable

if TYPE_CHECKING:
    from minitouch_bench.verification.verify import Verification
    from minitouch_bench.workflows.verify import VerifyOptions

CHECK_FAILED = 1
SHOWN = 10
"""Differences that are listed; the rest is counted."""

rerun_option = partial(typer.Option, rich_help_panel="Running again")


def verify(
    run: options.RunDirectory,
    *,
    again: Annotated[
        int, rerun_option("--rerun", min=0, help="Also run N drawn episodes with the checkpoint.")
    ] = 0,
    policy: Annotated[
        str | None, rerun_option(help="Where the checkpoint is now; by default where it was.")
    ] = None,
    exploration: Annotated[
        str | None, rerun_option(help="Where the exploration checkpoint is now.")
    ] = None,
    draw: Annotated[
        int | None,
        rerun_option(min=0, help="Seed of the draw; by default one that nobody can foresee."),
    ] = None,
    workers: options.Workers = options.AUTO,
    engine: options.EngineName = "local",
    address: options.Address = None,
    isolation: options.IsolationLevel = Isolation.SANDBOX,
    trust: options.Trust = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Replay a run's recorded actions and recompute every figure; exit 1 if any differs."""
    from minitouch_bench.evaluation.engine import EngineOptions
    from minitouch_bench.workflows import verify as workflow

    asked = workflow.VerifyOptions(
        run,
        rerun=again,
        policy=policy,
        exploration=exploration,
        draw=workflow.unforeseen_draw() if draw is None else draw,
        engine=EngineOptions(engine, options.worker_count(workers), address),
        isolation=options.isolation_options(isolation, trust),
    )
    with EpisodeProgress(notes) as progress:
        result = workflow.verify(asked, progress.callbacks)
    if as_json:
        document = {"passed": result.passed, "draw": asked.draw, **asdict(result)}
        print(json.dumps(document, indent=1))
    else:
        _show(asked, result)
    if not result.passed:
        raise typer.Exit(CHECK_FAILED)


def _show(asked: "VerifyOptions", result: "Verification") -> None:
    console = data_console()

    def line(text: str, style: str = "") -> None:
        console.print(printable(text), style=style, markup=False, highlight=False, soft_wrap=True)

    for difference in result.problems[:SHOWN]:
        line(str(difference))
    if len(result.problems) > SHOWN:
        line(f"... and {len(result.problems) - SHOWN} more")
    if result.episodes:
        line(f"{result.episodes} episodes replayed from their recorded actions")
    if result.reran:
        line(f"{result.reran} episodes run again with the checkpoint (--draw {asked.draw})")
    if result.passed:
        line(f"{asked.run} is verified: every figure is what its episodes give", "bold green")
    else:
        line(f"{asked.run} is not verified", "bold red")
