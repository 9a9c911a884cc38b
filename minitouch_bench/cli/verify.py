"""``minitouch-bench verify``: what it prints."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from minitouch_bench.cli.console import data_console
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.workflows import options

if TYPE_CHECKING:
    from minitouch_bench.verification.verify import Verification

CHECK_FAILED = 1
SHOWN = 10
"""Differences that are listed; the rest is counted."""


def show_verification(
    result: "Verification", run: Path, *, as_json: options.AsJson = False
) -> None:
    """Print the differences, or that there are none."""
    if as_json:
        print(json.dumps({"passed": result.passed, **asdict(result)}, indent=1))
    else:
        _show(result, run)
    if not result.passed:
        raise typer.Exit(CHECK_FAILED)


def _show(result: "Verification", run: Path) -> None:
    console = data_console()

    def line(text: str, style: str = "") -> None:
        console.print(printable(text), style=style, markup=False, highlight=False, soft_wrap=True)

    for problem in result.problems[:SHOWN]:
        line(str(problem))
    if len(result.problems) > SHOWN:
        line(f"... and {len(result.problems) - SHOWN} more")
    if result.episodes:
        line(f"{result.episodes} episodes replayed from their recorded actions")
    if result.reran:
        line(f"{result.reran} episodes run again with the checkpoint (--draw {result.draw})")
    if result.passed:
        line(f"{run} is verified: every number follows from its episodes", "bold green")
    else:
        line(f"{run} is not verified", "bold red")
