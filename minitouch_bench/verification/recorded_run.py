"""A run as its directory holds it, held against its suite: each episode there once, in order."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from msgspec import UNSET

from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.actions import Actions, read_actions
from minitouch_bench.evaluation.suites import (
    SUITES,
    Suite,
    choose_episodes,
    choose_tasks,
    why_unofficial,
)
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import EpisodeMetrics, EpisodeSpec, Role, RunHeader, SavedRun
from minitouch_bench.reporting.run_directory import read_run
from minitouch_bench.verification.problems import Problem

NAMED = 3
"""Episodes named in one line; the rest are counted."""
IDENTITY = ("seed", "shape", "family", "split")
"""What the suite fixes of an episode, beside its task and index."""
RUN_AGAIN = "evaluate again with this version of minitouch-bench"
AS_WRITTEN = "take the run as it was written"


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
        if chosen := self.saved.header.chosen:
            there = ", ".join(chosen[:NAMED]) + (", …" if len(chosen) > NAMED else "")
        else:
            there = f"{self.specs[0].key} to {self.specs[-1].key}"
        raise UsageError(f"the run has no episode '{key}'; it has {there}")


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


def check_against_suite(saved: SavedRun) -> tuple[Problem, ...]:
    """Return every problem of a run's protocol, settings and episodes.

    Of a run of another protocol, or of impossible settings, nothing more can be said: its
    episodes are unknown here.
    """
    found = tuple(_protocol(saved.header)) or tuple(_settings(saved.header))
    return found or tuple(_episodes(saved))


def prescribed_episodes(header: RunHeader) -> tuple[EpisodeSpec, ...]:
    """Return the episodes that a run with these settings has, in order."""
    suite = SUITES[header.suite]
    suite = replace(suite, tasks=header.tasks, episodes_per_task=header.episodes, seed=header.seed)
    return _episodes_of(suite, header.exploration is not None, header.chosen)


@lru_cache(maxsize=8)
def _episodes_of(
    suite: Suite, exploration: bool, chosen: tuple[str, ...]
) -> tuple[EpisodeSpec, ...]:
    return suite.episodes(exploration=exploration, chosen=chosen)


def _protocol(header: RunHeader) -> Iterator[Problem]:
    """Hold the digest of each task against this installation's."""
    if header.suite not in SUITES:
        return  # which _settings says
    rules = {task: PROTOCOL.task_digest(task, header.suite) for task in header.tasks}
    other = [task for task, own in rules.items() if header.task_digests.get(task) != own]
    if other:
        recorded, own = header.task_digests.get(other[0], ""), rules[other[0]]
        yield Problem(
            "protocol",
            f"the rules of {', '.join(other)} are not this installation's ({other[0]}: "
            f"{recorded[:12] or 'none'} recorded, {own[:12]} here)",
            RUN_AGAIN,
            is_other_protocol=True,
        )


def _settings(header: RunHeader) -> Iterator[Problem]:
    """Hold what the header says of the run against the suite that it names."""
    if header.suite not in SUITES:
        yield Problem("header.suite", f"there is no suite '{header.suite}'", RUN_AGAIN)
        return
    suite = SUITES[header.suite]
    if not header.tasks or tuple(t for t in suite.tasks if t in header.tasks) != header.tasks:
        what = f"they are not tasks of {suite.name} in its order"
        yield Problem("header.tasks", what, RUN_AGAIN)
    elif not 0 < header.episodes <= MAX_EPISODES:
        yield Problem("header.episodes", f"a run has 1 to {MAX_EPISODES} per task", RUN_AGAIN)
    elif not _are_episodes(header.chosen, header, suite):
        what = f"they are not episodes of {suite.name} in its order"
        yield Problem("header.chosen_episodes", what, RUN_AGAIN)
    else:
        reasons = why_unofficial(header, suite)
        if header.unofficial_because != reasons:
            said, found = (
                "; ".join(listed) or "none" for listed in (header.unofficial_because, reasons)
            )
            what = f"the reasons given are {said}, those found {found}"
            yield Problem("header.unofficial_because", what, AS_WRITTEN)
        if header.official == bool(reasons):
            yield Problem("header.official", f"it is {header.official}", AS_WRITTEN)


def _are_episodes(chosen: Sequence[str], header: RunHeader, suite: Suite) -> bool:
    """Tell whether these are episodes of every task of a run, each once and in order."""
    if not chosen:
        return header.chosen_episodes is UNSET
    own = replace(suite, episodes_per_task=header.episodes)
    try:
        return choose_episodes(chosen, own) == chosen and (
            choose_tasks([key.partition("/")[0] for key in chosen], own) == header.tasks
        )
    except UsageError:
        return False


def _episodes(saved: SavedRun) -> Iterator[Problem]:
    """Hold the rows of both roles against the episodes that the settings prescribe."""
    specs = prescribed_episodes(saved.header)
    for role, rows in saved.by_role():
        asked = {(spec.task, spec.index): spec for spec in specs if spec.role is role}
        found = Counter((row.task, row.index) for row in rows)
        missing = [spec.key for key, spec in asked.items() if key not in found]
        twice = [_key(role, *key) for key, count in found.items() if count > 1]
        unknown = [_key(role, *key) for key in found if key not in asked]
        yield from _told(missing, "missing", "evaluate the whole suite")
        yield from _told(twice, "there twice", AS_WRITTEN)
        yield from _told(unknown, "not of the suite", AS_WRITTEN)
        if not (missing or twice or unknown):
            yield from _in_order(rows, tuple(asked.values()))


def _in_order(rows: Sequence[EpisodeMetrics], asked: Sequence[EpisodeSpec]) -> Iterator[Problem]:
    """Hold the rows, each of which is there once, against their order and what each must be."""
    moved = [
        spec.key
        for row, spec in zip(rows, asked, strict=True)
        if (row.task, row.index) != (spec.task, spec.index)
    ]
    if moved:
        yield from _told(moved, "not in the suite's order", AS_WRITTEN)
        return
    for name in IDENTITY:
        other = [
            spec.key
            for row, spec in zip(rows, asked, strict=True)
            if getattr(row, name) != getattr(spec, name)
        ]
        yield from _told(other, f"with another {name} than the suite's", RUN_AGAIN)


def _told(keys: Sequence[str], what: str, remedy: str) -> Iterator[Problem]:
    """Name the first few episodes that share a problem, and count the rest."""
    if keys:
        more = f" and {len(keys) - NAMED} more" if len(keys) > NAMED else ""
        count = f"{len(keys)} episode{'s are' if len(keys) > 1 else ' is'} {what}"
        yield Problem(keys[0], f"{count}: {', '.join(keys[:NAMED])}{more}", remedy)


def _key(role: Role, task: str, index: int) -> str:
    return EpisodeSpec(role, task, index, seed=0).key
