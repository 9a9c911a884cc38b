"""A run as its directory holds it, with the episodes that its suite prescribes."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.actions import Actions, read_actions
from minitouch_bench.records import EpisodeMetrics, EpisodeSpec, SavedRun
from minitouch_bench.reporting import read_run
from minitouch_bench.verification.problems import Problem
from minitouch_bench.verification.suite_check import check_against_suite, prescribed_episodes


@dataclass(frozen=True)
class RecordedRun:
    """A run that can be replayed: what was saved, its episodes in order, and their actions."""

    directory: Path
    saved: SavedRun
    specs: tuple[EpisodeSpec, ...]
    actions: Mapping[str, Actions]

    def rows(self) -> Iterator[tuple[EpisodeSpec, EpisodeMetrics]]:
        """Walk through the episodes with the row of each."""
        rows = (*self.saved.episodes, *self.saved.exploration_episodes)
        return zip(self.specs, rows, strict=True)

    def find(self, key: str) -> tuple[EpisodeSpec, EpisodeMetrics]:
        """Return the episode called ``key``, as ``pushing/17``.

        Raises:
            UsageError: there is none.
        """
        for spec, row in self.rows():
            if spec.key == key:
                return spec, row
        first, last = self.specs[0].key, self.specs[-1].key
        raise UsageError(f"the run has no episode '{key}'; it has {first} to {last}")


def open_run(directory: Path) -> tuple[RecordedRun | None, tuple[Problem, ...]]:
    """Read a run and hold it against its suite; None where it cannot be replayed.

    Raises:
        RunDirectoryError: it is no run, or a file of it is damaged.
    """
    saved = read_run(directory)
    if found := check_against_suite(saved):
        return None, found
    specs = prescribed_episodes(saved.header)
    actions = read_actions(directory, specs)
    if lacking := [spec.key for spec in specs if spec.key not in actions]:
        return None, tuple(Problem(key, "its actions are missing") for key in lacking)
    return RecordedRun(directory, saved, specs, actions), ()
