"""``minitouch-bench shapes``: make, prove, look at, exchange sets of shapes."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from minitouch_bench.shapegen.generate import generate as generate_set

app = typer.Typer(help="Make, prove, view and exchange sets of shapes.", no_args_is_help=True)


@app.callback()
def shapes() -> None:
    """Make, prove, view and exchange sets of shapes."""


Output = Annotated[Path, typer.Option("--output", help="Folder to write.")]
Workers = Annotated[int, typer.Option(min=1, help="Processes; the result never depends on it.")]


@contextmanager
def progress_bar(label: str) -> Iterator[Callable[[int, int], None]]:
    """Show a bar on stderr; yield a function that takes (done, total)."""
    columns = (TextColumn(label), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(label)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@app.command()
def generate(
    output: Output,
    count: Annotated[int, typer.Option(min=1, help="Number of shapes.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the set.")] = 0,
    workers: Workers = 1,
) -> None:
    """Make a set; run again after an interruption, it goes on where it stopped."""
    with progress_bar("shapes") as progress:
        result = generate_set(output, count, seed, workers, progress)
    typer.echo(f"{result.count} shapes in {result.folder}, digest {result.digest}")
    for reason, number in sorted(result.refused.items()):
        typer.echo(f"  refused on the way: {reason} {number}")


if __name__ == "__main__":
    app()
