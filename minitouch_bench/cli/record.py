"""``minitouch-bench record``: a policy's episodes as a dataset."""

from pathlib import Path
from typing import Annotated

import typer

from minitouch_bench.cli import options
from minitouch_bench.cli.console import EpisodeProgress, notes
from minitouch_bench.errors import PolicyFaultError
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.protocol.minitouch import TASK_NAMES


def record(
    policy: Annotated[str, typer.Argument(metavar="POLICY", help=options.POLICIES)],
    task: Annotated[str, typer.Argument(metavar="TASK", help=", ".join(TASK_NAMES))],
    *,
    output: Annotated[Path, typer.Option(metavar="DIR", help="The dataset's new directory.")],
    episodes: Annotated[int, typer.Option(min=1, help="How many to record.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Other seeds give other episodes.")] = 0,
    isolation: options.IsolationLevel = Isolation.SANDBOX,
    trust: options.Trust = False,
) -> None:
    """Record a policy's episodes in Minari's format, for train --from-log and other libraries."""
    from minitouch_bench.workflows import record as workflow

    held = options.isolation_options(isolation, trust)
    asked = workflow.RecordOptions(policy, task, output, episodes, seed, held)
    with EpisodeProgress(notes) as progress:
        done = workflow.record(asked, progress.callbacks)
    print(done.directory)
    if done.faults:
        notes.print(f"{done.faults} of {episodes} episodes end with a fault of the policy")
        raise typer.Exit(PolicyFaultError.exit_code)
