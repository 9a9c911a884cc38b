"""Check submissions as a maintainer does: the command ``leaderboard validate``."""

import os
import stat
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from minitouch_bench.errors import UsageError
from minitouch_bench.files import os_errors_as
from minitouch_bench.workflows import UNSEEN_VALIDATION, ValidationProgress, options
from minitouch_bench.workflows.options import StrPath

if TYPE_CHECKING:
    from minitouch_bench.leaderboard.validation import SubmissionFindings


def validate(
    *directories: Annotated[
        StrPath, typer.Argument(metavar="DIR", help="Directories of submissions.")
    ],
    prove: Annotated[bool, typer.Option()] = False,
    workers: options.Workers = options.AUTO,
    callbacks: ValidationProgress = UNSEEN_VALIDATION,
) -> "tuple[SubmissionFindings, ...]":
    """Check submissions without trusting them; exit 1 with every problem and how to correct it.

    A submission that cannot be read, or whose check cannot be finished, does not stop the others.

    Args:
        prove: Also replay every recorded action, run 20 sampled episodes of each policy again with
            its checkpoint and 50 new episodes per task, and write the proof that the leaderboard
            shows.

    Raises:
        UsageError: there is no such directory.
    """
    from minitouch_bench.evaluation.engine import open_engine
    from minitouch_bench.leaderboard import proving, validation

    places = [Path(directory) for directory in directories]
    for place in places:
        with os_errors_as(UsageError, place, "read"):
            if not stat.S_ISDIR(os.stat(place).st_mode):
                raise UsageError(f"{place} is not a directory; give a submission's directory")
    opening = options.engine_options("local", workers, None)
    results = []
    for place in places:
        found = validation.validate(place)
        if prove and found.passed:
            with open_engine(opening, callbacks.note) as engine:
                callbacks.phase("proof", proving.count_episodes(found))
                found = proving.prove(found, engine, callbacks.episode)
        results.append(found)
        callbacks.findings(found)
    return tuple(results)
