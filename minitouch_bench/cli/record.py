"""``minitouch-bench record``: what it prints."""

from typing import TYPE_CHECKING

import typer

from minitouch_bench.cli.console import notes
from minitouch_bench.errors import PolicyFaultError

if TYPE_CHECKING:
    from minitouch_bench.workflows.record import RecordedDataset


def show_dataset(dataset: "RecordedDataset", episodes: int) -> None:
    """Print the dataset's directory; faults of the policy have their own exit code."""
    print(dataset.directory)
    if dataset.faults:
        notes.print(f"{dataset.faults} of {episodes} episodes end with a fault of the policy")
        raise typer.Exit(PolicyFaultError.exit_code)
