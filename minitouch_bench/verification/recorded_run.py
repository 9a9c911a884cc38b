"""A run as its directory holds it, with the episodes that its suite prescribes."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.actions import Actions, read_actions
from minitouch_bench.evaluation.suites import SUITES, why_unofficial
from minitouch_bench.files import RUN_FILE
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import EpisodeMetrics, EpisodeSpec, Role, RunHeader, SavedRun
from minitouch_bench.reporting import read_run
from minitouch_bench.verification.differences import Difference, compare_values

IDENTITY = ("task", "index", "seed", "shape", "family", "split")
"""What a row says of an episode before anything has happened in it."""

MAX_EPISODES = 100_000


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


def open_run(directory: Path) -> tuple[RecordedRun | None, tuple[Difference, ...]]:
    """Read a run and hold it against its suite; None where it cannot be replayed.

    Raises:
        RunDirectoryError: it is no run, or a file of it is damaged.
    """
    saved = read_run(directory)
    found = list(_protocol(saved.header)) or list(_settings(saved.header))
    if found:
        return None, tuple(found)
    specs = _prescribed(saved.header)
    found = list(_rows(saved, specs))
    actions = read_actions(directory, specs)
    found += [Difference(s.key, "its actions are missing") for s in specs if s.key not in actions]
    if found:
        return None, tuple(found)
    return RecordedRun(directory, saved, specs, actions), ()


def _protocol(header: RunHeader) -> Iterator[Difference]:
    if header.protocol_digest != PROTOCOL.digest():
        yield Difference(
            "protocol",
            f"the run's is {header.protocol} {header.protocol_digest[:12]}, this installation's "
            f"{PROTOCOL.digest()[:12]}; only the version that made a run can replay it",
        )


def _settings(header: RunHeader) -> Iterator[Difference]:
    """Hold what the header says of the run against the suite that it names."""
    if header.suite not in SUITES:
        yield Difference("header.suite", f"there is no suite '{header.suite}'")
        return
    suite = SUITES[header.suite]
    if not header.tasks or tuple(t for t in suite.tasks if t in header.tasks) != header.tasks:
        yield Difference("header.tasks", f"they are not tasks of {suite.name} in its order")
    elif not 0 < header.episodes <= MAX_EPISODES:
        yield Difference("header.episodes", f"{header.episodes} episodes a task are no run")
    else:
        reasons = why_unofficial(header, suite)
        recorded = {"official": header.official, "because": header.unofficial_because}
        found = {"official": not reasons, "because": reasons}
        yield from compare_values("header", recorded, found)


def _prescribed(header: RunHeader) -> tuple[EpisodeSpec, ...]:
    suite = replace(
        SUITES[header.suite],
        tasks=header.tasks,
        episodes_per_task=header.episodes,
        seed=header.seed,
    )
    return suite.episodes(exploration=header.exploration is not None)


def _rows(saved: SavedRun, specs: tuple[EpisodeSpec, ...]) -> Iterator[Difference]:
    """Hold the rows against the episodes: each there once, in order, with its seed and shape."""
    for role, rows in (
        (Role.FINAL, saved.episodes),
        (Role.EXPLORATION, saved.exploration_episodes),
    ):
        asked = [spec for spec in specs if spec.role is role]
        there = {(row.task, row.index) for row in rows}
        missing = [spec.key for spec in asked if (spec.task, spec.index) not in there]
        if missing:
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            yield Difference(missing[0], f"this episode{more} is missing")
        elif len(rows) != len(asked):
            yield Difference(RUN_FILE, f"{len(rows)} {role} episodes, the suite has {len(asked)}")
        else:
            for spec, row in zip(asked, rows, strict=True):
                recorded = {name: getattr(row, name) for name in IDENTITY}
                prescribed = {name: getattr(spec, name) for name in IDENTITY}
                yield from compare_values(spec.key, recorded, prescribed)
