"""A run: what was asked for, its directory, and the episodes that are missing from it."""

import platform
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from msgspec import UNSET

from minitouch_bench.conditions import STANDARD, Conditions
from minitouch_bench.errors import HopelessRunError, RunDirectoryError, UsageError
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.evaluation.engine import Engine
from minitouch_bench.evaluation.journal import Journal, read_journal
from minitouch_bench.evaluation.rollout import given_path
from minitouch_bench.evaluation.suites import Suite, why_unofficial
from minitouch_bench.files import (
    ATTEMPTS,
    clear_folder,
    clear_run,
    entries_of,
    holds_run,
    make_folder,
)
from minitouch_bench.policies.limits import USUAL_LIMITS
from minitouch_bench.policies.sources import identify
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import (
    EpisodeRecord,
    EpisodeSpec,
    EvaluationRun,
    Outcome,
    PolicyIdentity,
    RunEnvironment,
    RunHeader,
)

PACKAGES = (
    "minitouch-bench",
    "pybullet",
    "gymnasium",
    "numpy",
    "torch",
    "onnxruntime",
    "stable-baselines3",
)
"""What a run's numbers may depend on; those that are installed stand in ``run.json``."""

HOPELESS_AFTER = 10
"""A run whose first episodes, this many, are all policy faults ends there."""


@dataclass(frozen=True)
class RunRequest:
    """What to run: the suite as published, and this run's own settings of it.

    ``chosen`` names the episodes to run, as in "pushing/17"; none for all.
    """

    suite: Suite
    tasks: tuple[str, ...]
    episodes: int
    seed: int
    setup: PolicySetup
    chosen: tuple[str, ...] = ()

    def header(self) -> RunHeader:
        """Return what fixes the run's numbers."""
        exploration = self.setup.exploration
        limits = self.setup.isolation.limits
        is_usual = limits.episode_timeout_s == USUAL_LIMITS.episode_timeout_s
        header = RunHeader(
            protocol=PROTOCOL.name,
            protocol_digest=PROTOCOL.digest(),
            task_digests={task: PROTOCOL.task_digest(task, self.suite.name) for task in self.tasks},
            suite=self.suite.name,
            official=True,
            unofficial_because=(),
            tasks=self.tasks,
            episodes=self.episodes,
            seed=self.seed,
            policy=identify(self.setup.policy),
            exploration=None if exploration is None else identify(exploration),
            act_timeout_s=limits.act_timeout_s,
            conditions=UNSET if self.setup.conditions == STANDARD else self.setup.conditions,
            episode_timeout_s=UNSET if is_usual else limits.episode_timeout_s,
            isolation=self.setup.isolation_level(),
            chosen_episodes=self.chosen or UNSET,
        )
        reasons = why_unofficial(header, self.suite)
        return replace(header, official=not reasons, unofficial_because=reasons)

    def specs(self) -> tuple[EpisodeSpec, ...]:
        """Return the episodes, in the suite's order."""
        suite = replace(
            self.suite, tasks=self.tasks, episodes_per_task=self.episodes, seed=self.seed
        )
        exploration = self.setup.exploration is not None
        return suite.episodes(exploration=exploration, chosen=self.chosen)


@dataclass(frozen=True)
class OpenRun:
    """A run with the episodes that are done. ``directory`` None: it is kept in memory only.

    ``torn``: the journal's last line was torn by a crash, and has been cut off.
    """

    header: RunHeader
    directory: Path | None = None
    records: tuple[EpisodeRecord, ...] = ()
    torn: bool = False


def open_run(request: RunRequest, directory: Path, *, resume: bool, fresh: bool) -> OpenRun:
    """Open a run's directory, which must be locked: write the header, or read what is done.

    Raises:
        UsageError: both ``resume`` and ``fresh``.
        RunDirectoryError: it holds a run and neither was asked for, or a run of other
            settings; the text names the differences. Or it holds other files and no run.
    """
    if resume and fresh:
        raise UsageError("choose one of --resume and --fresh")
    header = request.header()
    if fresh:
        clear_run(directory)
    if not holds_run(directory):
        if not fresh:
            _check_empty(directory)
        with Journal(directory) as journal:
            journal.write_header(header, package_versions())
        return OpenRun(header, directory)
    if not resume:
        raise RunDirectoryError(
            f"{directory} holds a run already.\n"
            "Add --resume to continue it, --fresh to replace it, or --output for another directory"
        )

    def specs_of(found: RunHeader) -> tuple[EpisodeSpec, ...]:
        _check_same(header, found, directory)
        return request.specs()

    _, records, torn = read_journal(directory, specs_of, packages=package_versions())
    return OpenRun(header, directory, tuple(records), torn)


def _check_empty(directory: Path) -> None:
    """Refuse a directory of other files: one of them could be called as one of a run is."""
    if found := entries_of(directory):
        more = f" and {len(found) - 1} more" if len(found) > 1 else ""
        raise RunDirectoryError(
            f"{directory} is not empty and holds no run: {found[0]!a}{more}.\n"
            "Choose another --output; or add --fresh: files called as a run's are then replaced"
        )


def run_episodes(
    request: RunRequest,
    opened: OpenRun,
    engine: Engine,
    on_record: Callable[[EpisodeRecord], None],
) -> EvaluationRun:
    """Run the episodes that ``opened`` lacks and return the whole run.

    Where the run has a directory, each record is in its journal before ``on_record`` sees it.

    Raises:
        InfrastructureError: the run is incomplete; what is done is kept in the journal.
        HopelessRunError: so does it where its first episodes are all policy faults; a run that
            is resumed after them goes on.
    """
    specs = request.specs()
    records = {record.spec: record for record in opened.records}
    missing = [spec for spec in specs if spec not in records]
    started, clock, workers = datetime.now(UTC), time.monotonic(), engine.workers
    setup = request.setup
    if opened.directory is not None:
        setup = setup.keep_out_of(opened.directory)
    with _kept(opened) as (journal, attempts):
        for record in engine.run(setup, missing, attempts):
            if journal is not None and attempts is not None:
                journal.write_record(record)
                given_path(attempts, record.spec.key).unlink(missing_ok=True)
            records[record.spec] = record
            on_record(record)
            if len(opened.records) < len(records) == HOPELESS_AFTER < len(specs):
                _refuse_hopeless(records.values())
    environment = RunEnvironment(
        packages=package_versions(),
        machine={"system": platform.platform(), "processor": _processor()},
        workers=workers,
        started=started.isoformat(timespec="seconds"),
        wall_s=round(time.monotonic() - clock, 3),
    )
    return EvaluationRun(opened.header, environment, tuple(records[spec] for spec in specs))


def _refuse_hopeless(records: Iterable[EpisodeRecord]) -> None:
    """Give a run up whose episodes so far are all policy faults."""
    faults = [record.fault for record in records if record.outcome is Outcome.POLICY_FAULT]
    if len(faults) == HOPELESS_AFTER:
        raise HopelessRunError(
            f"the first {HOPELESS_AFTER} episodes are all policy faults: {faults[0]}"
        )


@contextmanager
def _kept(opened: OpenRun) -> Iterator[tuple[Journal | None, Path | None]]:
    """Open the journal of a run and its folder of attempts, which a finished run needs no more."""
    if opened.directory is None:
        yield None, None
        return
    attempts = opened.directory / ATTEMPTS
    make_folder(attempts)
    with Journal(opened.directory) as journal:
        yield journal, attempts
    with suppress(OSError):
        clear_folder(opened.directory, ATTEMPTS)


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
    if value is UNSET:
        return "the usual"
    if isinstance(value, Conditions):
        return ", ".join(value.in_words())
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
