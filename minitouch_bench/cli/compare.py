"""``minitouch-bench compare``: runs of the same episodes, each against the first."""

from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli.console import data_console, notes
from minitouch_bench.files import write_file


def compare(
    runs: Annotated[
        list[Path], typer.Argument(metavar="A B [C ...]", help="Directories of finished runs.")
    ],
    *,
    output: Annotated[
        Path | None, typer.Option(help="Write comparison.md and comparison.json there.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the comparison as JSON in place of the tables.")
    ] = False,
) -> None:
    """Compare runs episode by episode: differences, intervals, verdicts, changed outcomes."""
    from minitouch_bench.regression.comparison import compare_runs
    from minitouch_bench.regression.writers import (
        comparison_json,
        comparison_markdown,
        show_comparison,
    )
    from minitouch_bench.runs.run import read_run

    comparison = compare_runs([read_run(run) for run in runs], list(map(str, runs)))
    if output is not None:
        write_file(output / "comparison.json", comparison_json(comparison))
        write_file(output / "comparison.md", comparison_markdown(comparison))
    if as_json:
        print(comparison_json(comparison), end="")
    else:
        show_comparison(comparison, data_console())
    if output is not None:
        notes.print(f"comparison: {output / 'comparison.md'}", markup=False)
