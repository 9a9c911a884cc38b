"""``minitouch-bench shapes``: make, prove, look at, exchange sets of shapes."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

app = typer.Typer(help="Make, prove, view and exchange sets of shapes.", no_args_is_help=True)

Folder = Annotated[Path, typer.Argument(help="Folder of a shape set.", show_default=False)]
Output = Annotated[Path, typer.Option("--output", help="Folder to write.")]
Workers = Annotated[int, typer.Option(min=1, help="Processes; the result never depends on it.")]


@contextmanager
def progress_bar(label: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function that takes (done, total); its first call shows a bar on stderr."""
    columns = (TextColumn(label), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    bar = Progress(*columns, console=Console(stderr=True))
    task = bar.add_task(label, total=None)
    is_shown = False

    def show(done: int, total: int) -> None:
        nonlocal is_shown
        if not is_shown:
            bar.start()
            is_shown = True
        bar.update(task, completed=done, total=total)

    try:
        yield show
    finally:
        if is_shown:
            bar.stop()


@app.command()
def generate(
    output: Output,
    count: Annotated[int, typer.Option(min=1, help="Number of shapes.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the set.")] = 0,
    workers: Workers = 1,
) -> None:
    """Make a set; run again after an interruption, it goes on where it stopped."""
    from minitouch_bench.shapegen import generate as workflow

    with progress_bar("shapes") as progress:
        result = workflow.generate(output, count, seed, workers, progress)
    typer.echo(f"{result.count} shapes in {result.folder}, digest {result.digest}")
    for reason, number in sorted(result.refused.items()):
        typer.echo(f"  refused on the way: {reason} {number}")


@app.command()
def check(
    folder: Folder,
    workers: Workers = 1,
    quick: Annotated[bool, typer.Option(help="Leave out the proofs in the simulator.")] = False,
) -> None:
    """Prove a set against its manifest; exit 1 with the reasons if it does not hold."""
    from minitouch_bench.shapegen.check import check_set

    with progress_bar("proofs") as progress:
        report = check_set(folder, workers, quick, progress)
    for problem in report.problems:
        typer.echo(problem)
    if report.problems:
        typer.echo(f"{folder}: {len(report.problems)} problems", err=True)
        raise typer.Exit(1)
    chance = "" if report.p_value is None else f", split p = {report.p_value:.3f}"
    typer.echo(f"{len(report.shapes.shapes)} shapes hold, digest {report.shapes.digest}{chance}")


@app.command("stats")
def show_stats(folder: Folder) -> None:
    """Print the distribution of a set and the test of its split."""
    from minitouch_bench.shapegen.manifest import load_shape_set
    from minitouch_bench.shapegen.stats import stats_text

    typer.echo(stats_text(load_shape_set(folder)))


@app.command()
def preview(folder: Folder, output: Output) -> None:
    """Draw contact sheets by family and split, and a page to browse the set offline."""
    from minitouch_bench.shapegen import preview as workflow
    from minitouch_bench.shapegen.manifest import load_shape_set

    with progress_bar("pictures") as progress:
        written = workflow.preview(load_shape_set(folder), output, progress)
    for path in written:
        typer.echo(path)


@app.command("import")
def import_objects(  # noqa: PLR0917 - each parameter is an option of the command
    source: Annotated[Path, typer.Argument(help="Folder of OBJ, STL, GLB or URDF objects.")],
    output: Output,
    scale: Annotated[float, typer.Option(help="Meters in one unit of the files.")] = 1.0,
    fit: Annotated[bool, typer.Option(help="Give each object a size the hand can grip.")] = False,
    density: Annotated[float, typer.Option(min=1.0, help="Density in kg/m3.")] = 1000.0,
    workers: Workers = 1,
) -> None:
    """Make a set of given objects; exit 1 with the reason of each refusal."""
    from minitouch_bench.shapegen import importing
    from minitouch_bench.shapegen.soundness import Reason

    config = importing.ImportConfig(scale, fit, density)
    with progress_bar("objects") as progress:
        result = importing.import_objects(source, output, config, workers, progress)
    for name, reason in result.refused.items():
        typer.echo(f"{name}: {reason}")
    typer.echo(f"{result.accepted} accepted, {len(result.refused)} refused")
    for reason, number in sorted(result.reasons().items()):
        typer.echo(f"  {number:5d} {reason}")
    sizes = (Reason.SIZE.value, Reason.TOO_WIDE.value, Reason.TOO_FLAT.value)
    if not fit and any(reason.startswith(sizes) for reason in result.refused.values()):
        typer.echo(
            "--fit gives each object a size the hand can grip; --scale sets the unit", err=True
        )
    if result.accepted:
        typer.echo(f"set in {result.folder}, digest {result.digest}")
    if result.refused or not result.accepted:
        raise typer.Exit(1)


@app.command()
def export(
    folder: Folder,
    output: Output,
    form: Annotated[str, typer.Option("--format", help="urdf, obj, glb or mjcf.")] = "urdf",
    split: Annotated[str | None, typer.Option(help="train or held-out; both if absent.")] = None,
) -> None:
    """Write the shapes as files for other programs."""
    from minitouch_bench.shapegen import exporting
    from minitouch_bench.shapegen.manifest import load_shape_set

    count = exporting.export(load_shape_set(folder), output, form, split)
    typer.echo(f"{count} files in {output}")


if __name__ == "__main__":
    app()
