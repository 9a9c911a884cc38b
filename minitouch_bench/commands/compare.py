"""The command ``compare``: runs of the same episodes, each against the first."""

from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli import options
from minitouch_bench.cli.console import data_console, note


def compare(
    runs: options.RunsArgument,
    *,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Write comparison.md and comparison.json to this directory."
        ),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Compare runs episode by episode: differences, intervals, verdicts, changed outcomes.

    Each run is compared with the first one.
    """
    from minitouch_bench import api
    from minitouch_bench.comparison.comparison import comparison_json, show_comparison

    comparison = api.compare(*runs, output=output)
    if as_json:
        print(comparison_json(comparison), end="")
    else:
        show_comparison(comparison, data_console())
    if output is not None:
        note(f"comparison: {output / 'comparison.md'}")
