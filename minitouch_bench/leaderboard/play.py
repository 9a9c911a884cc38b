"""Play a submission's checkpoints on this machine, and keep the results as files.

``reports/results/NAME/`` holds the draws of the fresh episodes, written before the first of them,
and the facts of each finished run, without actions: the checkpoints give them again. Unfinished
runs lie in ``reports/play/NAME/``, by their draw, where an interrupted ``play`` continues.
"""

import gzip
import secrets
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from minitouch_bench import errors, files
from minitouch_bench.episode import Episode, Outcome, PlayedEpisode, Role, Sha256OrNone
from minitouch_bench.evaluation.engine import SILENT, Callbacks, Engine, Note
from minitouch_bench.evaluation.execution import header_of, open_run, play_run
from minitouch_bench.evaluation.policy_setup import prepare_policies
from minitouch_bench.json_io import read_toml, take_table, whole, write_toml
from minitouch_bench.leaderboard.fresh import drop_p, fresh_plan
from minitouch_bench.leaderboard.ranking import RunsBySuite
from minitouch_bench.leaderboard.submission import Submission, read_submission
from minitouch_bench.machine import machine_facts
from minitouch_bench.policies.sources import SubmittedTraining
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.runs.plan import Plan, make_plan
from minitouch_bench.runs.run import Run, read_run
from minitouch_bench.verification.static_check import check_episodes

PLAY = files.REPORTS / "play"
"""Directory of rows that are being played."""

ROW_FILE = "row.toml"
FRESH = "-fresh"
"""Ending of the name of a folder with fresh episodes."""

PLAY_LIMIT_S = 6 * 3600.0
"""How long a training may take to play; a policy may use minutes in each episode."""
MEASURED_S = 3600.0
"""After so long the time of a training is estimated; the machine can be busy for some minutes."""


@dataclass(frozen=True)
class FreshDraw:
    """Randomness for the fresh episodes of a training, drawn when its policies were fixed.

    ``final`` and ``exploration``: digests of the policies that it was drawn for. ``at``: when, in
    UTC. ``processor``: of the machine.
    """

    seed: int
    final: Sha256OrNone
    exploration: Sha256OrNone
    randomness: Annotated[str, Meta(pattern=whole("[0-9a-f]{32,}"))]
    at: str
    processor: str


@dataclass(frozen=True)
class RowFacts:
    """What ``row.toml`` says.

    ``draws``: of the trainings that were played last. ``retired``: of trainings that were replaced
    or taken out since they were drawn for.
    ``played``: the suites that every training has finished, with their fresh episodes: those that
    a board shows.
    ``drop_p``: see ``fresh.drop_p``, over these suites. ``waiting``: why the rest is not played,
    as a policy that cannot be loaded; "" if nothing prevents it.
    """

    draws: tuple[FreshDraw, ...] = ()
    retired: tuple[FreshDraw, ...] = ()
    played: tuple[str, ...] = ()
    drop_p: Annotated[float, Meta(ge=0, le=1)] = 1.0
    waiting: str = ""
    format: Literal["minitouch-row"] = "minitouch-row"
    version: Literal[1] = 1

    def draw_for(self, training: SubmittedTraining) -> FreshDraw | None:
        """Return the draw for a training's policies as they are, None where there is none."""
        wanted = (training.seed, training.digest(Role.FINAL), training.digest(Role.EXPLORATION))
        found = (one for one in self.draws if (one.seed, one.final, one.exploration) == wanted)
        return next(found, None)


@dataclass(frozen=True)
class RowRun:
    """A run of a row: a suite, or its fresh episodes, with the policies of one training."""

    training: SubmittedTraining
    draw: FreshDraw
    plan: Plan
    is_fresh: bool

    @property
    def explores(self) -> bool:
        """Whether the exploration policy plays too."""
        return self.plan.suite == MAIN_SUITE and bool(self.training.files(Role.EXPLORATION))

    @property
    def place(self) -> str:
        """Where it lies below the row's folder."""
        return f"{self.training.folder}/{self.plan.suite}{FRESH if self.is_fresh else ''}"


@dataclass(frozen=True)
class Entry:
    """A submission in its ``directory``, and the folder of its ``results``."""

    directory: Path
    submission: Submission
    results: Path

    @classmethod
    def open(cls, directory: Path, results: Path) -> "Entry":
        """Return the submission of a directory; ``results`` is the folder of all rows.

        Raises:
            UsageError: it is not a submission.
        """
        return cls(directory, read_submission(directory), results / directory.name)

    @property
    def name(self) -> str:
        """Name of the submission."""
        return self.submission.name

    def policy(self, training: SubmittedTraining) -> str:
        """Return what ``evaluate`` takes as the POLICY of a training."""
        return self.name if self.submission.is_built_in else str(self.directory / training.folder)

    def read_row(self) -> RowFacts:
        """Return the facts in ``row.toml``, or a row without draws if there is no such file.

        Raises:
            RunDirectoryError: it is damaged.
        """
        path = self.results / ROW_FILE
        if not path.exists():
            return RowFacts()
        try:
            return take_table(read_toml(path), RowFacts, str(path))
        except errors.UsageError as error:
            raise errors.RunDirectoryError(str(error)) from error

    def parts(self, row: RowFacts) -> Iterator[RowRun]:
        """Yield the runs of each training that has a draw."""
        for training in self.submission.trainings:
            draw = row.draw_for(training)
            if draw is None:
                continue
            for suite in self.submission.suites:
                yield RowRun(training, draw, make_plan(suite), is_fresh=False)
                fresh = fresh_plan(suite, training.digest(Role.FINAL), draw.randomness)
                yield RowRun(training, draw, fresh, is_fresh=True)

    def read_run(self, part: RowRun) -> Run | None:
        """Return a finished run, None where it was not played.

        Raises:
            RunDirectoryError: the file is damaged, or the run is of other policies or rules.
        """
        path = self.results / part.place / files.PACKED_RUN_FILE
        if not path.exists():
            return None
        run = replace(read_run(path), name=f"{self.name}/{part.place}", content=b"")
        roles = (*Role,) if part.explores else (Role.FINAL,)
        digests = [policy.digest for policy in run.header.policies()]
        if digests != [part.training.digest(role) for role in roles]:
            raise errors.RunDirectoryError(f"{path} is of other checkpoints")
        if run.plan != part.plan:
            raise errors.RunDirectoryError(f"{path} is of other episodes")
        for problem in check_episodes(run):
            raise errors.RunDirectoryError(f"{path}: {problem}")
        return run

    def read(self, row: RowFacts | None = None) -> "PlayedRow":
        """Return a row with the suites that ``row``, by default ``row.toml``, says are played.

        It has no suite if a training of the submission was added, replaced or taken out since.

        Raises:
            RunDirectoryError: a file is missing or damaged, or a run is of other policies or rules.
        """
        row = row or self.read_row()
        played = [suite for suite in self.submission.suites if suite in row.played]
        if row.draws != tuple(map(row.draw_for, self.submission.trainings)):
            played = []
        found: dict[bool, dict[str, list[Run]]] = {
            is_fresh: {suite: [] for suite in played} for is_fresh in (False, True)
        }
        for part in self.parts(row):
            if part.plan.suite in played:
                if (run := self.read_run(part)) is None:
                    raise errors.RunDirectoryError(f"{self.results} lacks {part.place}")
                found[part.is_fresh][part.plan.suite].append(run)
        return PlayedRow(self.submission, row, found[False], found[True])


@dataclass(frozen=True)
class PlayedRow:
    """A submission with what ``play`` kept of it: its draws, and the runs of finished suites."""

    submission: Submission
    row: RowFacts
    official: RunsBySuite
    fresh: RunsBySuite

    def episodes(self, task: str) -> list[list[Episode]]:
        """Return the final policy's episodes of a task of the main suite, of each training."""
        runs = self.official.get(MAIN_SUITE, ())
        return [[row for row in run.rows if row.task == task] for run in runs]


def play_row(
    entry: Entry,
    engine: Engine,
    callbacks: Callbacks,
    *,
    suites: Sequence[str] = (),
    directory: Path = PLAY,
) -> RowFacts:
    """Play the runs of a row that are missing or changed, and return what is kept of it.

    ``suites``: only these of the submission's. ``directory``: of unfinished runs.

    Raises:
        RunDirectoryError: another process plays it, or a file cannot be written.
        InfrastructureError, InterruptedRunError: it is incomplete; the same call continues.
    """
    with files.lock_directory(entry.results):
        row = _keep_draws(entry)
        wanted = suites or entry.submission.suites
        missing = [*_missing(entry, row, wanted, callbacks.note)]
        lacking = {part.plan.suite for part in missing}
        row = replace(row, played=tuple(suite for suite in row.played if suite not in lacking))
        waiting = ""
        try:
            for number, part in enumerate(missing, start=1):
                callbacks.note(f"{entry.name}/{part.place}, {number} of {len(missing)} runs")
                left = sum(
                    len(one.plan.specs(exploration=one.explores))
                    for one in missing[number - 1 :]
                    if one.training == part.training
                )
                _play_part(entry, part, engine, callbacks, left=left, directory=directory)
        except (errors.HopelessRunError, errors.PolicyLoadError) as error:
            waiting = str(error).partition("\n")[0]
        finally:  # also of a play that ends here: a board shows the suites that are finished
            row = replace(_with_played(entry, row), waiting=waiting)
            files.write_file(entry.results / ROW_FILE, write_toml(row))
        return row


def _with_played(entry: Entry, row: RowFacts) -> RowFacts:
    """Return a row with the suites that are finished by now, and the test for a drop over them."""
    suites = entry.submission.suites
    missing = {part.plan.suite for part in _missing(entry, row, suites, SILENT.note)}
    played = tuple(suite for suite in suites if suite not in missing)
    if played == row.played:
        return row
    now = entry.read(replace(row, played=played))
    return replace(row, played=played, drop_p=drop_p(now.official, now.fresh) if played else 1.0)


def _keep_draws(entry: Entry) -> RowFacts:
    """Draw for each training whose policies are new, and keep the draws of the others."""
    row = entry.read_row()
    draws = tuple(
        row.draw_for(training)
        or FreshDraw(
            training.seed,
            training.digest(Role.FINAL),
            training.digest(Role.EXPLORATION),
            secrets.token_hex(32),
            datetime.now(UTC).isoformat(timespec="seconds"),
            machine_facts()["processor"],
        )
        for training in entry.submission.trainings
    )
    if draws != row.draws:
        before = dict.fromkeys((*row.retired, *row.draws))
        row = RowFacts(draws, tuple(one for one in before if one not in draws))
        files.write_file(entry.results / ROW_FILE, write_toml(row))
    return row


def _missing(entry: Entry, row: RowFacts, suites: Sequence[str], note: Note) -> Iterator[RowRun]:
    """Yield the runs of suites without a result, or with one that is damaged or of other rules."""
    for part in entry.parts(row):
        if part.plan.suite not in suites:
            continue
        try:
            if entry.read_run(part) is None:
                yield part
        except errors.RunDirectoryError as error:
            note(f"{error}: it is played again")
            yield part


def _within_limit(callbacks: Callbacks, episodes: int, kept: int) -> Callbacks:
    """Return callbacks that end a training whose ``episodes`` would take too long.

    The first ``kept`` were played before: no time of theirs is known.
    """
    started, played = time.monotonic(), -kept

    def episode(record: PlayedEpisode) -> None:
        nonlocal played
        callbacks.episode(record)
        played += 1
        elapsed = time.monotonic() - started
        if played < 1 or elapsed < MEASURED_S:
            return
        seconds = elapsed / played * (episodes - kept)
        if seconds > PLAY_LIMIT_S:
            hours = f"about {seconds / 3600:.0f} hours, the limit is {PLAY_LIMIT_S / 3600:.0f}"
            raise errors.HopelessRunError(f"to play a training would take {hours}")

    return replace(callbacks, episode=episode)


def _play_part(
    entry: Entry,
    part: RowRun,
    engine: Engine,
    callbacks: Callbacks,
    *,
    left: int,
    directory: Path,
) -> None:
    """Play a run of a row, or go on with it; ``left``: episodes of its training not in a result."""
    policy = entry.policy(part.training)
    setup = prepare_policies(
        policy,
        part.plan,
        note=callbacks.note,
        exploration=policy if part.explores else None,
        name=entry.name,
    )
    header = header_of(setup)
    # By the draw: a row that is played again elsewhere continues no run of another draw.
    place = directory / entry.name / part.draw.randomness[:12] / part.place
    with files.lock_directory(place):
        try:
            opened = open_run(header, place, resume=True)
        except errors.UnreadableFileError:
            raise
        except errors.RunDirectoryError as error:  # of a replaced checkpoint or other packages
            why = str(error).partition("\n")[0].rstrip(".")
            callbacks.note(f"{why}: it is played from the beginning")
            opened = open_run(header, place, fresh=True)
        kept = [] if isinstance(opened, Run) else [*opened.records.values()]
        if kept and all(one.outcome is Outcome.POLICY_FAULT for one in kept):
            opened, kept = open_run(header, place, fresh=True), []  # it ends after as many again
        told = _within_limit(callbacks, left, len(kept))
        run = play_run(setup, opened, engine, told, how="")
    content = gzip.compress(run.content, mtime=0)
    files.write_file(entry.results / part.place / files.PACKED_RUN_FILE, content)
    shutil.rmtree(place)
    with suppress(OSError):  # other runs may be unfinished
        for folder in [*place.parents][:3]:
            folder.rmdir()
