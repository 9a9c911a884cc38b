"""What each command prints of the result of its workflow."""

from typing import TYPE_CHECKING

import typer

from minitouch_bench.cli.console import data_console
from minitouch_bench.workflows import options

if TYPE_CHECKING:
    from minitouch_bench.regression.gate import GateResult


def show_gate(result: "GateResult", *, as_json: options.AsJson = False) -> None:
    """Print a gate's result, which has its own exit code."""
    from minitouch_bench.regression.writers import gate_json, show_result

    if as_json:
        print(gate_json(result), end="")
    else:
        show_result(result, data_console())
    if result.exit_code:
        raise typer.Exit(result.exit_code)
