"""``minitouch-bench replay``: look at one recorded episode."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.table import Table

from minitouch_bench.cli.consoles import data_console, notes
from minitouch_bench.errors import InterruptedRunError, UsageError
from minitouch_bench.evaluation.filming import film, film_name
from minitouch_bench.evaluation.replay import Recording
from minitouch_bench.evaluation.rollout import EpisodeRunner
from minitouch_bench.records import EpisodeRecord, EpisodeSpec
from minitouch_bench.sensing.touch import FORCES, POSITION
from minitouch_bench.verification.recorded_run import RecordedRun, open_run

CHECK_FAILED = 1
HEADINGS = ("step", "action", "end effector (m)", "fingers (N)", "contact (ticks)", "object")


def replay(
    run: Annotated[Path, typer.Argument(help="Directory of a finished run.")],
    episode: Annotated[str, typer.Argument(help="As pushing/17 or exploration/pushing/17.")],
    *,
    film_file: Annotated[
        Path | None,
        typer.Option("--film", help="An .mp4 or .gif; by default in RUN/replays/."),
    ] = None,
    steps: Annotated[
        bool, typer.Option("--steps", help="Print what happened at each step, film nothing.")
    ] = False,
) -> None:
    """Replay a recorded episode without its policy: film it, or print it step by step."""
    opened, differences = open_run(run)
    if opened is None:
        raise UsageError(f"{run} cannot be replayed.\n{differences[0]}")
    spec, row = opened.find(episode)
    try:
        record = _replayed(opened, spec)
        if steps:
            _print_steps(record)
        else:
            path = film_file or run / "replays" / film_name(spec.key, _suffix())
            notes.print(f"filming {len(record.trace.actions) + 1} frames", markup=False)
            film(spec, record.trace.actions, path)
            print(path)
    except KeyboardInterrupt as error:
        raise InterruptedRunError("interrupted") from error
    same = record.trace.digest() == row.digest
    verdict = "the same bits as recorded" if same else "NOT the bits that were recorded"
    count = len(record.trace.actions)
    notes.print(f"{spec.key}: {row.outcome} after {count} steps; {verdict}", markup=False)
    if not same:
        raise typer.Exit(CHECK_FAILED)


def _replayed(run: RecordedRun, spec: EpisodeSpec) -> EpisodeRecord:
    runner = EpisodeRunner(Recording(run.actions))
    try:
        return runner.run(spec)
    finally:
        runner.close()


def _suffix() -> str:
    """Return the kind of film that this installation can write."""
    return ".mp4" if find_spec("imageio_ffmpeg") and find_spec("imageio") else ".gif"


def _print_steps(record: EpisodeRecord) -> None:
    """Print one row a step: the action, and what was measured after it."""
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


def _numbers(values: NDArray[Any], form: str) -> str:
    return " ".join(format(float(value), form) for value in values)
