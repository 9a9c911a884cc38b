"""Check submissions as a maintainer does: the command ``leaderboard validate``."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from minitouch_bench.errors import IncompleteCheckError, RunDirectoryError, UsageError
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.workflows import UNSEEN_VALIDATION, ValidationProgress, options
from minitouch_bench.workflows.options import StrPath

if TYPE_CHECKING:
    from minitouch_bench.workflows.proving import Validation


def validate(
    *directories: Annotated[
        StrPath, typer.Argument(metavar="DIR", help="Directories of submissions.")
    ],
    replay: Annotated[bool, typer.Option()] = False,
    rerun: Annotated[int, typer.Option(min=0, max=MAX_EPISODES)] = 0,
    fresh_seeds: Annotated[int, typer.Option(min=0, max=MAX_EPISODES)] = 0,
    draw: Annotated[str | None, typer.Option(metavar="TEXT")] = None,
    workers: options.Workers = options.AUTO,
    time_limit: Annotated[float | None, typer.Option(metavar="S", min=1.0)] = None,
    callbacks: ValidationProgress = UNSEEN_VALIDATION,
) -> "tuple[Validation, ...]":
    """Check submissions without trusting them; exit 1 with every problem and how to correct it.

    A submission that cannot be read, or whose check cannot be finished, does not stop the others.

    Args:
        replay: Replay every recorded action, and write a proof that the leaderboard shows;
            --rerun and --fresh-seeds do this too.
        rerun: Also run N sampled episodes of each policy of each run with its checkpoint.
        fresh_seeds: Also run N new episodes per task of each run: 50 is usual, fewer than 20
            give no level.
        draw: Text from which the new seeds follow; the submitter must not know it before the
            checkpoint is fixed. By default 128 random bits in hexadecimal; a text must
            be as long.
        time_limit: Seconds for the check of each submission; by default 6 hours.

    Raises:
        UsageError: the draw is too short.
    """
    from minitouch_bench.leaderboard.proof import MIN_FRESH_EPISODES
    from minitouch_bench.verification.fresh import new_draw
    from minitouch_bench.workflows import proving

    if draw is not None and len(draw) < (least := len(new_draw())):
        raise UsageError(f"--draw needs {least} characters: 128 random bits in hexadecimal")
    if 0 < fresh_seeds < MIN_FRESH_EPISODES:
        callbacks.note(f"fewer than {MIN_FRESH_EPISODES} fresh episodes per task give no level")
    prove = partial(
        proving.prove,
        rerun=rerun,
        fresh_episodes=fresh_seeds,
        draw=draw or new_draw(),
        engine=options.engine_options("local", workers, None),
        time_limit_s=time_limit or proving.TIME_LIMIT_S,
        callbacks=callbacks,
    )
    plays = replay or rerun or fresh_seeds
    results = []
    for directory in map(Path, directories):
        try:
            result = proving.validate_submission(directory, prove if plays else None)
        except (IncompleteCheckError, RunDirectoryError) as error:
            result = proving.Validation((), error=error)
        results.append(replace(result, name=directory.name or str(directory)))
        callbacks.verdict(results[-1])
    return tuple(results)
