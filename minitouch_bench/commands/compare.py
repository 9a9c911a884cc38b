"""``minitouch-bench compare``: runs of the same episodes beside one another."""

from pathlib import Path
from typing import Annotated

from minitouch_bench.commands import options
from minitouch_bench.commands.options import argument, option
from minitouch_bench.console import data_console, note
from minitouch_bench.errors import UsageError


def compare(
    runs: Annotated[list[Path] | None, argument("RUN", "Directories of finished runs.")] = None,
    *,
    a: Annotated[
        list[Path] | None, option("RUN", "A run of a training seed of method A; repeat it.")
    ] = None,
    b: Annotated[
        list[Path] | None, option("RUN", "A run of a training seed of method B; repeat it.")
    ] = None,
    output: Annotated[
        Path | None, option("DIR", "Write comparison.md and comparison.json to this directory.")
    ] = None,
    html: Annotated[
        Path | None, option("FILE.html", "Write a page with the tables and maps of starts.")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Compare runs episode by episode: differences, intervals, verdicts, changed outcomes.

    Each run is compared with the first one; with --a and --b, two methods by their training seeds.
    """
    from minitouch_bench import api
    from minitouch_bench.comparison.comparison import WrittenComparison

    if html is not None and html.suffix != ".html":
        raise UsageError(f"--html is an .html file, not '{html.name}'")
    if a or b:
        if runs:
            raise UsageError("compare takes either RUN... or --a RUN... --b RUN...")
        if html is not None:
            raise UsageError("--html is for compare RUN..., which pairs episodes")
        found: WrittenComparison = api.compare_methods(a or [], b or [], output=output)
    else:
        found = api.compare(*(runs or ()), output=output, html=html)
    if as_json:
        print(found.to_json(), end="")
    else:
        found.show(data_console())
    if output is not None:
        note(f"comparison: {output / 'comparison.md'}")
    if html is not None:
        note(f"page: {html}")
