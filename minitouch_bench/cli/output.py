"""What each command prints of the result of its workflow."""

import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from minitouch_bench.cli.console import data_console, note
from minitouch_bench.errors import (
    IncompleteCheckError,
    PolicyFaultError,
    RunDirectoryError,
    printable,
)
from minitouch_bench.workflows import options

if TYPE_CHECKING:
    from minitouch_bench.leaderboard.packing import Packed
    from minitouch_bench.leaderboard.validation import SubmissionFindings
    from minitouch_bench.records import EpisodeRecord
    from minitouch_bench.regression.comparison import Comparison
    from minitouch_bench.regression.gate import GateResult
    from minitouch_bench.verification.problems import Findings
    from minitouch_bench.workflows.record import RecordedDataset
    from minitouch_bench.workflows.replay import ReplayedEpisode
    from minitouch_bench.workflows.report import ShownReport

CHECK_FAILED = 1
"""Exit code of a check that was made; one that cannot be made has that of its error."""

SHOWN = 10
"""Differences that are listed; the others are counted."""

STEP_HEADINGS = ("step", "action", "end effector (m)", "fingers (N)", "contact (ticks)", "object")


def show_written_report(shown: "ShownReport") -> None:
    """Print Table 4 as text, or the tables and where the page is."""
    from minitouch_bench.reporting.writers import show_report

    if shown.text:
        print(shown.text, end="")
        return
    show_report(shown.report, data_console())
    assert shown.directory is not None
    note(f"report: {shown.directory / 'report.html'}")


def show_comparison(
    comparison: "Comparison", output: Path | None, *, as_json: options.AsJson = False
) -> None:
    """Print a comparison, and where its page is."""
    from minitouch_bench.regression import writers

    if as_json:
        print(writers.comparison_json(comparison), end="")
    else:
        writers.show_comparison(comparison, data_console())
    if output is not None:
        note(f"comparison: {output / 'comparison.md'}")


def show_gate(result: "GateResult", *, as_json: options.AsJson = False) -> None:
    """Print a gate's result, which has its own exit code."""
    from minitouch_bench.regression.writers import gate_json, show_result

    if as_json:
        print(gate_json(result), end="")
    else:
        show_result(result, data_console())
    if result.exit_code:
        raise typer.Exit(result.exit_code)


def show_verification(result: "Findings", run: Path, *, as_json: options.AsJson = False) -> None:
    """Print the differences, or that there are none."""
    if as_json:
        print(json.dumps({"passed": result.passed, **asdict(result)}, indent=1))
    else:
        _show_problems(result, run)
    if not result.passed:
        raise typer.Exit(CHECK_FAILED)


def _show_problems(result: "Findings", run: Path) -> None:
    console = data_console()

    def line(text: str, style: str = "") -> None:
        console.print(printable(text), style=style, markup=False, highlight=False, soft_wrap=True)

    for problem in result.problems[:SHOWN]:
        line(str(problem))
    if len(result.problems) > SHOWN:
        line(f"... and {len(result.problems) - SHOWN} more")
    if result.replayed:
        line(f"{result.replayed} episodes replayed from their recorded actions")
    if result.reran:
        line(f"{result.reran} episodes run again with the checkpoint")
    if result.passed:
        line(f"{run} is verified: every number follows from its episodes", "bold green")
    else:
        line(f"{run} is not verified", "bold red")


def show_replay(
    replayed: "ReplayedEpisode",
    *,
    video: Annotated[Path | None, typer.Option(metavar="FILE")] = None,
    steps: Annotated[bool, typer.Option()] = False,
) -> None:
    """Record a video of the episode or print its steps, and say whether its bits are the same.

    Args:
        video: Video file, .mp4 or .gif; by default in RUN/replays/, of a submission's run in
            reports/.
        steps: Print what happened at each step, and record no video.
    """
    from minitouch_bench.workflows.replay import write_replay_video

    record, row = replayed.record, replayed.row
    count = len(record.trace.actions)
    if steps:
        _print_steps(record)
    else:
        note(f"recording a video of {count + 1} frames")
        print(write_replay_video(replayed, video))
    bits = "the same bits as recorded" if replayed.is_same else "NOT the bits that were recorded"
    note(f"{record.spec.key}: {row.outcome} after {count} steps; {bits}")
    if not replayed.is_same:
        raise typer.Exit(CHECK_FAILED)


def _print_steps(record: "EpisodeRecord") -> None:
    """Print one row per step: the action, and what was measured after it."""
    import numpy as np
    from rich.table import Table

    from minitouch_bench.simulation.observation import FORCES, POSITION

    def numbers(values: Iterable[Any], form: str) -> str:
        return " ".join(format(float(value), form) for value in values)

    title = f"{record.spec.key}  {record.spec.shape}".rstrip()
    table = Table(*STEP_HEADINGS, title=title, title_justify="left")
    for column in table.columns:
        column.justify = "right"
    trace = record.trace
    for step, action in enumerate(trace.actions):
        touch = trace.touch[step + 1]
        left, right = np.linalg.norm(touch[FORCES].reshape(2, 3), axis=1)
        table.add_row(
            str(step),
            numbers(action, "+.2f"),
            numbers(touch[POSITION], ".3f"),
            f"{left:.1f} {right:.1f}",
            f"{trace.contact_ticks[step]} of {trace.ticks[step]}",
            numbers(trace.object_state[step + 1], ".4f"),
        )
    is_angle = trace.object_state.shape[1] == 1
    table.caption = f"object: {'door angle, rad' if is_angle else 'position, m'}"
    data_console().print(table)


def show_directory(directory: Path) -> None:
    """Print the training's directory."""
    print(directory)


def show_dataset(dataset: "RecordedDataset", episodes: int) -> None:
    """Print the dataset's directory; faults of the policy have their own exit code."""
    print(dataset.directory)
    if dataset.faults:
        note(f"{dataset.faults} of {episodes} episodes end with a fault of the policy")
        raise typer.Exit(PolicyFaultError.exit_code)


def show_packed(packed: "Packed") -> None:
    """Print a submission's directory, or its problems, and what to type next."""
    for problem in packed.problems:
        print(f"{packed.directory.name}: {problem}")
    if packed.problems:
        raise typer.Exit(CHECK_FAILED)
    print(packed.directory)
    note(
        f"valid; next: minitouch-bench leaderboard validate {packed.directory} --prove, "
        "then minitouch-bench leaderboard build"
    )


def show_validation(result: "SubmissionFindings") -> None:
    """Print a submission's problems, or its level of proof."""
    print_problems(result.name, filter(None, (result.error, *result.problems)))
    name = printable(result.name)
    if result.withdrawn:
        print(f"{name}: its proof ({result.withdrawn}) is withdrawn")
    if result.passed:
        print(f"{name}: valid, {result.level}")


def show_validations(results: "tuple[SubmissionFindings, ...]") -> None:
    """Print how many submissions are valid; the others give the exit code."""
    valid = sum(result.passed for result in results)
    note(f"{valid} of {len(results)} valid")
    if any(not problem.is_unchecked for result in results for problem in result.problems):
        raise typer.Exit(CHECK_FAILED)
    if valid < len(results):
        is_incomplete = any(isinstance(result.error, IncompleteCheckError) for result in results)
        unchecked = IncompleteCheckError if is_incomplete else RunDirectoryError
        raise typer.Exit(unchecked.exit_code)


def print_problems(name: str, problems: Iterable[object]) -> None:
    """Print a line for each problem of a submission."""
    for problem in problems:
        print(f"{printable(name)}: {problem}")
