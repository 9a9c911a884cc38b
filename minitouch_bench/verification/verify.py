"""A run checked without trust: its actions replayed, and drawn episodes run again."""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from minitouch_bench.documents import plain
from minitouch_bench.errors import RunDirectoryError, UnreadableFileError, UsageError
from minitouch_bench.evaluation.actions import Actions, Recording
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.evaluation.engine import Engine
from minitouch_bench.evaluation.journal import read_journal
from minitouch_bench.files import JOURNAL_FILE, RUN_FILE, os_errors_as, read_file
from minitouch_bench.metrics.summary import summarize
from minitouch_bench.policies.sources import PolicySource, identify
from minitouch_bench.records import (
    EpisodeMetrics,
    EpisodeRecord,
    EpisodeSpec,
    EvaluationRun,
    PolicyIdentity,
    SavedRun,
)
from minitouch_bench.reporting.run_directory import derived_files, document_of, run_json, save
from minitouch_bench.verification.problems import ROUNDING, Problem, compare_values
from minitouch_bench.verification.recorded_run import RecordedRun, open_run

EPISODE_LISTS = ("episodes", "exploration_episodes")


@dataclass(frozen=True)
class Verification:
    """What a check of a run found. ``episodes`` were replayed, ``reran`` run with the policy."""

    episodes: int
    problems: tuple[Problem, ...]
    reran: int = 0

    @property
    def passed(self) -> bool:
        """Whether everything is as recorded."""
        return not self.problems


def verify_run(
    directory: Path, engine: Engine, on_record: Callable[[EpisodeRecord], None] = lambda _: None
) -> Verification:
    """Replay every episode of a run and recompute all that its files say.

    The episodes come from the suite, the actions from ``actions.npz``. From the replayed
    trajectories every metric and digest is computed again and compared bit for bit with
    ``run.json``, and every estimate up to ROUNDING. The tables and the report beside it must be
    those that ``run.json`` gives, the journal that of the replayed episodes.
    ``on_record`` takes each replayed episode. The texts of faults, and what the policy and
    the machine were called, cannot be recomputed and are taken as they are.

    Raises:
        RunDirectoryError: it is no run, or a file of it is damaged.
        InfrastructureError: an episode could not be replayed.
    """
    run, problems = open_run(directory)
    return Verification(0, problems) if run is None else replay_run(run, engine, on_record)


def replay_run(
    run: RecordedRun, engine: Engine, on_record: Callable[[EpisodeRecord], None] = lambda _: None
) -> Verification:
    """Replay every episode of an opened run and recompute its files: see ``verify_run``.

    Raises:
        InfrastructureError: an episode could not be replayed.
    """
    records = []
    recording = Recording(run.actions, run.saved.header.played_under)
    for record in engine.run(recording, run.specs):
        records.append(record)
        on_record(record)
    found = tuple(compare_with_replay(run, records))
    return Verification(len(records), found)


def compare_with_replay(run: RecordedRun, records: list[EpisodeRecord]) -> Iterator[Problem]:
    """Compare everything a run's directory holds with its replayed episodes."""
    by_spec = {record.spec: record for record in records}
    for spec in run.specs:
        given, used = len(run.actions[spec.key]), len(by_spec[spec].trace.actions)
        if given != used:
            text = f"{given} actions recorded, the episode ends after {used}"
            yield Problem(spec.key, text)
    replayed = tuple(
        _with_claims(by_spec[spec], row, run.saved.faults.get(spec.key, ""))
        for spec, row in run.rows()
    )
    evaluation = EvaluationRun(run.saved.header, run.saved.environment, replayed)
    found = save(evaluation, summarize(evaluation), run.saved.name)
    if others := tuple(_other_episodes(run, found)):
        yield from others
        return  # every figure, table and journal follows from the episodes
    yield from _documents(run, found)
    yield from _files(run)
    if os.path.lexists(run.directory / JOURNAL_FILE):
        yield from _journal(run, replayed)


def _with_claims(record: EpisodeRecord, row: EpisodeMetrics, fault: str) -> EpisodeRecord:
    """Add to a replayed episode what only the policy's own process knew.

    The recorded actions are clipped already. A clipped one has a component of exactly -1 or
    1: so many at most are taken from what the row claims.
    """
    at_bounds = np.flatnonzero((np.abs(record.trace.actions) == 1).any(axis=1))
    clipped = np.zeros(len(record.trace.actions), np.bool_)
    clipped[at_bounds[: row.clipped_actions]] = True
    return replace(record, trace=replace(record.trace, clipped=clipped), fault=fault)


def _other_episodes(run: RecordedRun, replayed: SavedRun) -> Iterator[Problem]:
    """Name each episode that its recorded actions do not give, with all that differs in it."""
    again = (*replayed.episodes, *replayed.exploration_episodes)
    for (spec, row), other in zip(run.rows(), again, strict=True):
        if row.digest != other.digest:
            names = [field.name for field in fields(row) if _differs(row, other, field.name)]
            what = f"its actions do not give the episode recorded: other {', '.join(names)}"
            yield Problem(f"{spec.key}.digest", what)


def _differs(row: EpisodeMetrics, other: EpisodeMetrics, name: str) -> bool:
    return bool(getattr(row, name) != getattr(other, name))


def _documents(run: RecordedRun, replayed: SavedRun) -> Iterator[Problem]:
    """Compare ``run.json`` with the document of the replayed run, episodes by their names."""
    if read_file(run.directory / RUN_FILE) != run_json(run.saved):
        yield Problem(RUN_FILE, "a key is there twice or unknown, or it was edited")
    recorded, found = plain(document_of(run.saved)), plain(document_of(replayed))
    names = [spec.key for spec in run.specs]
    rows = [row for name in EPISODE_LISTS for row in recorded.pop(name)]
    again = [row for name in EPISODE_LISTS for row in found.pop(name)]
    for key, row, other in zip(names, rows, again, strict=True):
        yield from compare_values(key, row, other)
    for name, value in recorded.items():
        if name != "environment":
            yield from compare_values(name, value, found[name], ROUNDING)


def _files(run: RecordedRun) -> Iterator[Problem]:
    """Compare the tables and the report with those that ``run.json`` gives."""
    for name, text in derived_files(run.saved, run.directory).items():
        path = run.directory / name
        if not os.path.lexists(path):
            continue
        with os_errors_as(UnreadableFileError, path, "read"):
            content = read_file(path)
        if content != text.encode():
            yield Problem(name, _first_line(content, text))


def _first_line(content: bytes, text: str) -> str:
    there, again = content.decode(errors="replace").splitlines(), text.splitlines()
    for number, (one, other) in enumerate(zip(there, again, strict=False), start=1):
        if one != other:
            return f"line {number} is not what run.json gives"
    return f"{len(there)} lines, run.json gives {len(again)}"


def _journal(run: RecordedRun, records: tuple[EpisodeRecord, ...]) -> Iterator[Problem]:
    """Compare the journal, whose records are whole, with the replayed episodes."""
    try:
        header, written, _ = read_journal(run.directory, lambda _: run.specs, repair=False)
    except UnreadableFileError:
        raise
    except RunDirectoryError as error:
        yield Problem(JOURNAL_FILE, str(error).partition("\n")[0])
        return
    if header != run.saved.header:
        yield Problem(JOURNAL_FILE, "its header is not that of run.json")
    by_spec = {record.spec: record for record in written}
    for record in records:
        there = by_spec.get(record.spec)
        if there is None:
            yield Problem(JOURNAL_FILE, f"{record.spec.key} is missing")
        elif _contents(there) != _contents(record):
            yield Problem(JOURNAL_FILE, f"{record.spec.key} is not what its actions give")


def _contents(record: EpisodeRecord) -> tuple[object, ...]:
    clipped = int(np.count_nonzero(record.trace.clipped))
    return record.outcome, record.fault, record.trace.digest(), clipped


def draw_episodes(
    run: RecordedRun, count: int, rng: np.random.Generator
) -> tuple[EpisodeSpec, ...]:
    """Draw so many episodes of a run, or all it has, in the run's order.

    Whoever made the run must not be able to foresee them: seed ``rng`` from the machine.
    """
    size = min(count, len(run.specs))
    return tuple(run.specs[i] for i in sorted(rng.choice(len(run.specs), size, replace=False)))


def check_identity(recorded: PolicyIdentity, source: PolicySource) -> None:
    """Refuse a checkpoint that is not the one evaluated.

    Raises:
        UsageError: its kind or its bytes are others.
    """
    found = identify(source)
    if (found.kind, found.digest) != (recorded.kind, recorded.digest):
        raise UsageError(
            f"{source.target} is not the policy of this run: {_in_words(found)}, "
            f"the run's is {_in_words(recorded)}"
        )


def rerun(
    run: RecordedRun, setup: PolicySetup, specs: Sequence[EpisodeSpec], engine: Engine
) -> Iterator[tuple[EpisodeRecord, tuple[Problem, ...]]]:
    """Run these episodes with the checkpoint and yield each with how it differs.

    Raises:
        InfrastructureError: an episode failed three times for no fault of the policy.
    """
    rows = dict(run.rows())
    for record in engine.run(setup, specs):
        recorded = run.actions[record.spec.key]
        yield record, tuple(_differences(record, rows[record.spec], recorded))


def _differences(
    record: EpisodeRecord, row: EpisodeMetrics, recorded: Actions
) -> Iterator[Problem]:
    key, found = record.spec.key, record.trace.actions
    if record.outcome is not row.outcome:
        yield Problem(key, f"{row.outcome} recorded, {record.outcome} when run again")
    elif record.trace.digest() != row.digest:
        yield Problem(key, _first_other_step(recorded, found))


def _first_other_step(recorded: Actions, found: Actions) -> str:
    for step, (one, other) in enumerate(zip(recorded, found, strict=False)):
        if one.tobytes() != other.tobytes():
            return f"action {step} was {one.tolist()}, when run again {other.tolist()}"
    if len(recorded) != len(found):
        return f"{len(recorded)} steps recorded, {len(found)} when run again"
    return "the actions are the same, the trajectory is not: is it the same processor?"


def _in_words(identity: PolicyIdentity) -> str:
    return f"{identity.kind} {identity.digest[:12]}".rstrip()
