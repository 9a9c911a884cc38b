"""The commands, one per file, and the callbacks that report what a long one does."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from minitouch_bench.agents.training import ProgressRow
    from minitouch_bench.records import EpisodeRecord


def ignore(*_: object) -> None:
    """Do nothing."""


@dataclass(frozen=True)
class Callbacks:
    """Functions that a workflow calls while it runs; each does nothing by default.

    ``note`` takes one line for the user. ``phase`` takes what begins now, in a word or two, and
    its number of episodes; ``episode`` takes each episode of the phase as it ends.
    """

    note: Callable[[str], None] = ignore
    phase: Callable[[str, int], None] = ignore
    episode: Callable[["EpisodeRecord"], None] = ignore


SILENT = Callbacks()


@dataclass(frozen=True)
class TrainingProgress:
    """Functions that a training calls while it runs; each does nothing by default.

    ``note`` takes one line for the user. ``begin`` takes the control steps of both phases; ``row``
    takes each row of ``progress.csv``. ``should_stop`` is asked before each control step.
    """

    note: Callable[[str], None] = ignore
    begin: Callable[[int], None] = ignore
    row: Callable[["ProgressRow"], None] = ignore
    should_stop: Callable[[], bool] = lambda: False


UNSEEN = TrainingProgress()
