"""``minitouch-bench replay``: what it films or prints."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from minitouch_bench.cli.console import data_console, notes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from minitouch_bench.records import EpisodeRecord
    from minitouch_bench.workflows.replay import ReplayedEpisode

CHECK_FAILED = 1
HEADINGS = ("step", "action", "end effector (m)", "fingers (N)", "contact (ticks)", "object")


def show_replay(
    replayed: "ReplayedEpisode",
    *,
    film_file: Annotated[
        Path | None,
        typer.Option(
            "--film",
            metavar="FILE",
            help="An .mp4 or .gif; by default in RUN/replays/, of a submission's run in reports/.",
        ),
    ] = None,
    steps: Annotated[
        bool, typer.Option("--steps", help="Print what happened at each step, film nothing.")
    ] = False,
) -> None:
    """Film the episode or print its steps, and say whether its bits are those recorded."""
    from minitouch_bench.workflows.replay import film_replay

    record, row = replayed.record, replayed.row
    count = len(record.trace.actions)
    if steps:
        _print_steps(record)
    else:
        notes.print(f"filming {count + 1} frames", markup=False)
        print(film_replay(replayed, film_file))
    bits = "the same bits as recorded" if replayed.is_same else "NOT the bits that were recorded"
    notes.print(f"{record.spec.key}: {row.outcome} after {count} steps; {bits}", markup=False)
    if not replayed.is_same:
        raise typer.Exit(CHECK_FAILED)


def _print_steps(record: "EpisodeRecord") -> None:
    """Print one row per step: the action, and what was measured after it."""
    import numpy as np
    from rich.table import Table

    from minitouch_bench.simulation.observation import FORCES, POSITION

    table = Table(title=f"{record.spec.key}  {record.spec.shape}".rstrip(), title_justify="left")
    for heading in HEADINGS:
        table.add_column(heading, justify="right")
    trace = record.trace
    for step, action in enumerate(trace.actions):
        touch = trace.touch[step + 1]
        left, right = np.linalg.norm(touch[FORCES].reshape(2, 3), axis=1)
        table.add_row(
            str(step),
            _numbers(action, "+.2f"),
            _numbers(touch[POSITION], ".3f"),
            f"{left:.1f} {right:.1f}",
            f"{trace.contact_ticks[step]} of {trace.ticks[step]}",
            _numbers(trace.object_state[step + 1], ".4f"),
        )
    unit = "rad" if trace.object_state.shape[1] == 1 else "m"
    table.caption = f"object: {'door angle' if unit == 'rad' else 'position'}, {unit}"
    data_console().print(table)


def _numbers(values: "NDArray[Any]", form: str) -> str:
    return " ".join(format(float(value), form) for value in values)
