"""The main path: a contest of policies over a suite becomes an ``EvaluationRun``."""

import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.evaluation.engine import Contest, Engine
from minitouch_bench.evaluation.journal import Journal, read_journal
from minitouch_bench.evaluation.storage import clear_run, holds_run
from minitouch_bench.evaluation.suites import Suite
from minitouch_bench.policies.sources import identify
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import (
    EpisodeRecord,
    EvaluationRun,
    PolicyIdentity,
    RunEnvironment,
    RunHeader,
)

PACKAGES = ("minitouch-bench", "pybullet", "gymnasium", "numpy", "torch")


@dataclass(frozen=True)
class Request:
    """What to evaluate: the suite as published, and this run's own settings of it."""

    suite: Suite
    tasks: tuple[str, ...]
    episodes: int
    seed: int
    contest: Contest

    def header(self) -> RunHeader:
        """Return what fixes the run's numbers."""
        differences = self.suite.differences(self.tasks, self.episodes, self.seed)
        exploration = self.contest.exploration
        return RunHeader(
            protocol=PROTOCOL.name,
            protocol_digest=PROTOCOL.digest(),
            suite=self.suite.name,
            official=not differences,
            unofficial_because=differences,
            tasks=self.tasks,
            episodes=self.episodes,
            seed=self.seed,
            policy=identify(self.contest.policy),
            exploration=None if exploration is None else identify(exploration),
            act_timeout_s=self.contest.limits.act_timeout_s,
            isolation=self.contest.held_level(),
        )

    def chosen(self) -> Suite:
        """Return the suite with this run's settings."""
        return replace(
            self.suite, tasks=self.tasks, episodes_per_task=self.episodes, seed=self.seed
        )


@dataclass(frozen=True)
class Begun:
    """A run's directory, ready for the episodes that are missing."""

    header: RunHeader
    records: tuple[EpisodeRecord, ...]
    torn: bool = False


def begin(request: Request, directory: Path, *, resume: bool, fresh: bool) -> Begun:
    """Open a run's directory, which must be locked: write the header, or read what is done.

    Raises:
        UsageError: both ``resume`` and ``fresh``.
        RunDirectoryError: it holds a run and neither was asked for, or a run of other
            settings; the text names the differences.
    """
    if resume and fresh:
        raise UsageError("choose one of --resume and --fresh")
    header = request.header()
    if fresh:
        clear_run(directory)
    if not holds_run(directory):
        with Journal(directory) as journal:
            journal.write_header(header)
        return Begun(header, ())
    if not resume:
        raise RunDirectoryError(
            f"{directory} holds a run already.\n"
            "Add --resume to continue it, --fresh to replace it, or --output for another place"
        )
    found, records, torn = read_journal(directory)
    _check_same(header, found, directory)
    return Begun(header, tuple(records), torn)


def evaluate(
    request: Request,
    engine: Engine,
    begun: Begun,
    directory: Path,
    on_record: Callable[[EpisodeRecord], None],
    *,
    workers: int = 1,
) -> EvaluationRun:
    """Run the episodes that ``begun`` lacks and return the whole run.

    Each record is in the journal before ``on_record`` sees it.

    Raises:
        InfrastructureError: the run is incomplete; what is done is kept.
    """
    specs = request.chosen().episodes(exploration=request.contest.exploration is not None)
    records = {record.spec: record for record in begun.records}
    missing = [spec for spec in specs if spec not in records]
    started, clock = datetime.now(UTC), time.monotonic()
    with Journal(directory) as journal:
        for record in engine.run(request.contest, missing):
            journal.write_record(record)
            records[record.spec] = record
            on_record(record)
    environment = RunEnvironment(
        packages=package_versions(),
        machine={"system": platform.platform(), "processor": _processor()},
        workers=workers,
        started=started.isoformat(timespec="seconds"),
        wall_s=round(time.monotonic() - clock, 3),
    )
    return EvaluationRun(begun.header, environment, tuple(records[spec] for spec in specs))


def _check_same(wanted: RunHeader, found: RunHeader, directory: Path) -> None:
    pairs = [(f.name, getattr(found, f.name), getattr(wanted, f.name)) for f in fields(RunHeader)]
    differences = [
        f"{name}: {_in_words(there)} there, {_in_words(asked)} asked for"
        for name, there, asked in pairs
        if there != asked
    ]
    if differences:
        raise RunDirectoryError(
            f"{directory} holds another run and cannot be resumed.\n" + "; ".join(differences)
        )


def _in_words(value: object) -> str:
    if isinstance(value, PolicyIdentity):
        return f"{value.name} {value.digest[:12]}".rstrip()
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or "none"
    return "none" if value is None else str(value)


def package_versions() -> dict[str, str]:
    """Return the versions of the packages that a run's numbers may depend on."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _processor() -> str:
    """Return the processor's model, whose class bit-identity is promised for."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.machine()
