"""``minitouch-bench shapes``: make, check, view and exchange sets of shapes."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from minitouch_bench.commands.options import Command, argument, flag, make_group, option
from minitouch_bench.console import count_progress, note
from minitouch_bench.errors import UsageError
from minitouch_bench.text import numbered, printable

app = make_group(help="Make, check, view and exchange sets of shapes.")

Folder = Annotated[Path, typer.Argument(help="Folder of a shape set.", show_default=False)]
Output = Annotated[Path, option("DIR", "Folder to write.", "--output")]
Workers = Annotated[int, option("N", "Worker processes; the result is the same.", min=1)]


@app.command(cls=Command)
def generate(
    output: Output,
    count: Annotated[int, option("N", "Number of shapes.", min=1)] = 1000,
    seed: Annotated[int, option("N", "Seed of the set.", min=0)] = 0,
    workers: Workers = 1,
) -> None:
    """Make a set; after an interruption the same command continues it."""
    from minitouch_bench.shapegen import generate as workflow

    _check_name(output)
    with count_progress("shapes") as progress:
        digest = workflow.generate(output, count, seed, workers, progress)
    print(f"{numbered(count, 'shape')} in {output}, digest {digest}")


@app.command(cls=Command)
def check(
    folder: Folder,
    workers: Workers = 1,
    quick: Annotated[bool, flag("--quick", "Leave out the checks in the simulator.")] = False,
) -> None:
    """Check a set against its manifest; exit 1 with every difference."""
    from minitouch_bench.shapegen.check import check_set
    from minitouch_bench.shapegen.manifest import load_shape_set

    shapes = load_shape_set(folder)
    with count_progress("proofs") as progress:
        problems = check_set(shapes, workers, quick, progress)
    for problem in problems:
        print(printable(problem))
    if problems:
        note(f"{folder}: {numbered(len(problems), 'problem')}")
        raise typer.Exit(1)
    print(f"{numbered(len(shapes.shapes), 'shape')} as listed, digest {shapes.digest}")


@app.command(cls=Command)
def preview(folder: Folder, output: Output) -> None:
    """Write a page with a picture of every shape, to browse the set offline."""
    from minitouch_bench.shapegen import check as workflow
    from minitouch_bench.shapegen.manifest import load_shape_set

    with count_progress("pictures") as progress:
        print(workflow.preview(load_shape_set(folder), output, progress))


@app.command("import", cls=Command)
def import_objects(  # noqa: PLR0917 - each parameter is an option of the command
    sources: Annotated[
        list[Path], argument("SOURCE", "OBJ, STL, GLB or URDF files, or folders of them.")
    ],
    output: Output,
    scale: Annotated[
        list[str] | None,
        option("[FILE=]X", "Meters in a unit of the files, or of this one; may be repeated."),
    ] = None,
    fit: Annotated[bool, flag("--fit", "Give each object a size the hand can grip.")] = False,
    density: Annotated[
        float | None,
        option("X", "In kg/m3; by default near 1000, for a mass of 1.2 to 3.5 kg.", min=1.0),
    ] = None,
    fresh: Annotated[bool, flag("--fresh", "Replace the imported set in the folder.")] = False,
    workers: Workers = 1,
) -> None:
    """Make a set of given objects; exit 1 with the reason of each refusal."""
    from minitouch_bench.shapegen import exchange
    from minitouch_bench.shapegen.soundness import Reason

    _check_name(output)
    scales = _scales_of(scale or [])
    if fit and scales:
        raise UsageError("--fit gives each object its size: leave --scale out")
    config = exchange.ImportConfig(scales.pop("", 1.0), fit, density, scales)
    with count_progress("objects") as progress:
        result = exchange.import_objects(sources, output, config, workers, progress, fresh=fresh)
    for name, reason in result.refused.items():
        print(printable(f"{name}: {reason}"))
    for name, missed in result.not_promised.items():
        if missed:
            print(printable(f"{name}: accepted, not promised: {', '.join(missed)}"))
    print(f"{result.accepted} accepted, {len(result.refused)} refused")
    if not fit and any(reason.startswith(Reason.SIZE) for reason in result.refused.values()):
        note(
            "--fit gives each object a size the hand can grip; --scale sets the unit, "
            "--scale FILE=X that of one file"
        )
    if density is None:
        note("each weighs 1.2 to 3.5 kg, as fingers feel it; --density gives another weight")
    if result.accepted:
        print(f"set in {output}, digest {result.digest}")
    if result.refused:
        raise typer.Exit(1)


def _check_name(folder: Path) -> None:
    """See that ``--objects`` would find a set of this name.

    Raises:
        UsageError: it means objects of the benchmark.
    """
    from minitouch_bench.shapegen.manifest import OF_THE_BENCHMARK

    if str(folder) in OF_THE_BENCHMARK:
        raise UsageError(f"--objects {folder} means objects of the benchmark: choose another name")


def _scales_of(texts: list[str]) -> dict[str, float]:
    """Return the number of each ``--scale`` by file, "" for all the others.

    Raises:
        UsageError: one of them is not a number, or two are for the same files.
    """
    scales: dict[str, float] = {}
    for text in texts:
        name, _, number = text.rpartition("=")
        if name in scales:
            raise UsageError(f"--scale is given twice for {name or 'all files'}")
        try:
            scales[name] = float(number)
        except ValueError as error:
            raise UsageError(f"--scale is a number or FILE=NUMBER, not '{text}'") from error
    return scales


@app.command(cls=Command)
def export(
    folder: Folder,
    output: Output,
    form: Annotated[
        Literal["urdf", "obj"], option("urdf|obj", "Format of the files.", "--format")
    ] = "urdf",
    split: Annotated[str | None, option("NAME", "train or held-out; by default both.")] = None,
) -> None:
    """Write the shapes as files for other programs."""
    from minitouch_bench.shapegen import exchange
    from minitouch_bench.shapegen.manifest import load_shape_set

    count = exchange.export_shapes(load_shape_set(folder), output, form, split)
    print(f"{numbered(count, 'file')} in {output}")
