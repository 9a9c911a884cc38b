"""``minitouch-bench leaderboard``: check submissions, and draw the board."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from minitouch_bench.cli import options
from minitouch_bench.cli.consoles import notes
from minitouch_bench.evaluation.engine import core_count
from minitouch_bench.evaluation.local_engine import LocalEngine
from minitouch_bench.leaderboard import proof as proofs
from minitouch_bench.leaderboard.build import build_board
from minitouch_bench.leaderboard.faults import Fault
from minitouch_bench.leaderboard.proof import ProofLevel
from minitouch_bench.leaderboard.proving import Proving, replay, run_again
from minitouch_bench.leaderboard.validation import Verdict
from minitouch_bench.leaderboard.validation import validate as check
from minitouch_bench.rendering.escaping import printable

INVALID = 1

app = typer.Typer(help="Check submissions and draw the leaderboard.", no_args_is_help=True)


@app.command()
def validate(
    directories: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Directories of submissions.")
    ],
    replay_actions: Annotated[
        bool, typer.Option("--replay", help="Replay the recorded actions of every episode.")
    ] = False,
    rerun: Annotated[
        int,
        typer.Option(min=0, help="Run N drawn episodes of each run with the checkpoint, too."),
    ] = 0,
    workers: Annotated[str, typer.Option(help="Worker processes, or auto: one a core.")] = "auto",
) -> None:
    """Check submissions without trusting them; exit 1 with every fault and how to mend it.

    With --replay a proof is written beside them, which the board shows.
    """
    count = options.worker_count(workers) or core_count()
    valid = [_validate(directory, replay_actions, rerun, count) for directory in directories]
    notes.print(f"{sum(valid)} of {len(valid)} valid", markup=False)
    if not all(valid):
        raise typer.Exit(INVALID)


@app.command()
def build(
    submissions: Annotated[Path, typer.Option(help="Directory that holds the submissions.")] = Path(
        "submissions"
    ),
    output: Annotated[Path, typer.Option(help="Directory of the board.")] = Path(
        "reports/leaderboard"
    ),
) -> None:
    """Write the board as Markdown, CSV, JSON and a site that opens offline."""
    built = build_board(submissions, output, lambda name: notes.print(name, markup=False))
    for verdict in built.refused:
        _show_faults(verdict.directory.name, verdict.faults)
    notes.print(
        f"{built.ranked} ranked, {built.apart} of another protocol, {len(built.refused)} refused",
        markup=False,
    )
    print(output / "index.html")


def _validate(directory: Path, replayed: bool, rerun: int, workers: int) -> bool:
    """Check one submission, print the result, and tell whether it is valid."""
    verdict = check(directory)
    name = printable(directory.name or str(directory))
    faults = verdict.faults
    if verdict.passed and (replayed or rerun):
        faults = _prove(verdict, rerun, workers)
    if faults:
        _show_faults(name, faults)
        return False
    proof = proofs.read_proof(proofs.proof_path(directory.resolve()))
    print(f"{name}: valid, {proofs.level_of(verdict, proof)}")
    return True


def _prove(verdict: Verdict, rerun: int, workers: int) -> tuple[Fault, ...]:
    """Replay a submission, run some of it again, and write the proof if all holds."""
    episodes = sum(len(r.episodes) + len(r.exploration_episodes) for r in verdict.runs.values())
    columns = (TextColumn("replay"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("replay", total=episodes + rerun * len(verdict.runs))
        proving = Proving(LocalEngine(workers), progress=lambda: bar.advance(task))
        faults = [*replay(verdict, proving)]
        if not faults and rerun:
            faults += run_again(verdict, rerun, proving)
    if not faults:
        level = ProofLevel.RERUN if rerun else ProofLevel.REPLAYED
        proof = proofs.make_proof(verdict, level, rerun)
        proofs.write_proof(proof, proofs.proof_path(verdict.directory.resolve()))
    return tuple(faults)


def _show_faults(name: str, faults: tuple[Fault, ...]) -> None:
    for fault in faults:
        print(f"{printable(name)}: {fault}")
