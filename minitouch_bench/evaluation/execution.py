"""Begin or resume a run, play the episodes that are missing, and make the finished run."""

import hashlib
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from minitouch_bench import errors, files
from minitouch_bench.episode import Outcome
from minitouch_bench.evaluation.engine import Callbacks, Engine
from minitouch_bench.evaluation.policy_setup import PolicySetup
from minitouch_bench.machine import RunEnvironment, installed_versions, machine_facts
from minitouch_bench.policies.formats import computing_packages
from minitouch_bench.runs.actions import write_actions
from minitouch_bench.runs.journal import Journal, check_same
from minitouch_bench.runs.run import Run, RunHeader, make_header, make_run, read_run, run_json
from minitouch_bench.simulation.builds import BUILDS

PACKAGES = ("minitouch-bench", *BUILDS, "gymnasium", "numpy", *computing_packages())
"""What a run's numbers may depend on; ``run.json`` has the versions of those installed."""

HOPELESS_AFTER = 10
"""A run ends after so many episodes if all of them are policy faults."""

LONGEST_NAME = 80
"""Characters of a policy in a run's name, and of what differs from its suite."""


def header_of(setup: PolicySetup) -> RunHeader:
    """Return what fixes the numbers of the run that plays this."""
    policy, explorer = setup.policy, setup.exploration
    exploration = None if explorer is None else explorer.identity()
    return make_header(setup.plan, policy.identity(), exploration, setup.isolation_level())


def run_name(header: RunHeader) -> str:
    """Name a run after its policy, suite and what differs from the suite, fit for a file name."""
    policy = _file_name(header.policy.name)[:LONGEST_NAME] or "policy"
    changes = "-".join(map(_file_name, header.plan.differences()))
    if len(changes) > LONGEST_NAME:  # the digest tells apart what is the same up to here
        digest = hashlib.sha256(changes.encode()).hexdigest()[:8]
        changes = f"{_file_name(changes[: LONGEST_NAME - 9])}-{digest}"
    return "-".join(filter(None, (policy, header.plan.suite, changes)))


def default_directory(header: RunHeader, ending: str = "") -> Path:
    """Return the directory of a run without ``--output``, which has its name and ``ending``."""
    return files.REPORTS / f"{run_name(header)}{ending}"


def _file_name(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "-", text).strip(".-")


def open_run(
    header: RunHeader, directory: Path | None = None, *, resume: bool = False, fresh: bool = False
) -> Journal | Run:
    """Begin a run in a locked directory, or read what is done; a finished run is returned as it is.

    Without a directory the run is kept in memory only.

    Raises:
        UsageError: both ``resume`` and ``fresh``.
        RunDirectoryError: it holds a run and neither was asked for, or one that cannot be
            resumed; the text says why. Or it holds other files and no run; or it cannot be
            written.
    """
    if resume and fresh:
        raise errors.UsageError("choose one of --resume and --fresh")
    if directory is None:
        return Journal(header)
    if fresh:
        files.clear_run(directory)
    if not files.holds_run(directory):
        if not fresh:
            advice = (
                "It does not contain a run. Choose another directory; or add --fresh: files called "
                "as a run's are then replaced"
            )
            files.refuse_entries(directory, files.entries_of(directory), advice)
        return Journal.begin(header, package_versions(), directory)
    done: Journal | Run
    try:
        if (directory / files.RUN_FILE).exists():
            done = read_run(directory)
            check_same(header, done.header, directory)
        else:
            done = Journal.resume(header, package_versions(), directory)
    except errors.RunDirectoryError as error:
        advice = "Replace it with --fresh, or choose another --output"
        raise type(error)(f"{error}.\n{advice}") from error
    if not resume:
        raise errors.RunDirectoryError(
            f"{directory} already contains this run of {header.policy.name} on "
            f"{header.plan.suite}.\n"
            "Add --resume to continue it, --fresh to replace it, or choose another --output"
        )
    if isinstance(done, Run):
        Journal(header, directory).remove()  # a crash after the last file left it
    return done


def play_missing(setup: PolicySetup, journal: Journal, engine: Engine, callbacks: Callbacks) -> Run:
    """Play the episodes that are missing, and return the whole run.

    The journal keeps each record before the callbacks see it. Where the run has a directory,
    ``actions.npz`` is written there at the end.

    Raises:
        InfrastructureError: the run is incomplete, or was stopped; what is done is kept.
        HopelessRunError: so is one whose first episodes are all policy faults; a run that is
            resumed after them goes on.
    """
    header, directory, records = journal.header, journal.directory, journal.records
    specs = header.specs()
    missing = [spec for spec in specs if spec not in records]
    # Use the first planned episodes. Which finish first depends on the number of workers.
    first = specs[:HOPELESS_AFTER] if len(specs) > HOPELESS_AFTER else ()
    started, clock, workers = datetime.now(UTC), time.monotonic(), engine.workers
    if directory is not None:
        setup = setup.keep_out_of(directory)
    for record in engine.run(setup, missing):
        journal.keep(record)
        callbacks.episode(record)
        if record.spec in first and all(spec in records for spec in first):
            played = [records[spec] for spec in first]
            if all(one.outcome is Outcome.POLICY_FAULT for one in played):
                text = f"the first {len(first)} episodes are all policy faults: {played[0].fault}"
                raise errors.HopelessRunError(text)
        if len(records) < len(specs) and callbacks.should_stop():
            raise errors.InfrastructureError("stopped before the last episode, as was asked for")
    environment = RunEnvironment(
        packages=package_versions(),
        machine=machine_facts(),
        workers=workers,
        started=started.isoformat(timespec="seconds"),
        wall_s=round(time.monotonic() - clock, 3),
    )
    in_order = tuple(records[spec] for spec in specs)
    name = run_name(header) if directory is None else directory.resolve().name
    run = make_run(header, environment, in_order, name, directory)
    if directory is not None:
        write_actions(in_order, directory)
    return run


def package_versions() -> dict[str, str]:
    """Return the versions of the packages that a run's numbers may depend on."""
    return installed_versions(PACKAGES)


def play_run(
    setup: PolicySetup,
    opened: Journal | Run,
    engine: Engine,
    callbacks: Callbacks,
    how: str = "with --resume ",
) -> Run:
    """Play the episodes that are missing, and keep the facts of the run in its directory.

    ``how``: see ``resumable``. The callbacks also receive the episodes that are already done. A
    finished run is returned unchanged.
    """
    if isinstance(opened, Run):
        callbacks.note(f"{opened.directory} contains the finished run: no episode is missing")
        return opened
    callbacks.phase("episodes", len(opened.header.specs()))
    with resumable(opened.directory, how):
        for record in opened.records.values():
            callbacks.episode(record)
        run = play_missing(setup, opened, engine, callbacks)
        if run.directory is None:
            return run
        content = run_json(run)
        # A directory with it holds a finished run.
        files.write_file(run.directory / files.RUN_FILE, content)
    opened.remove()
    return replace(run, content=content)


@contextmanager
def resumable(directory: Path | None, how: str = "with --resume ") -> Iterator[None]:
    """Tell the user of an interrupted run how to continue it, or how to replace it.

    The same command continues it, ``how`` says with which option. A file that cannot be written,
    as on a full disk, interrupts a run too.
    """
    kept = f"What is done is kept in {directory}"
    usual = f"{kept}; the same command {how}continues."
    changed = (
        f"{kept}: --resume continues with the old file, --fresh begins again with the new one."
    )
    if not how:
        changed = f"{kept}; the same command continues with the old file."
    repeat = "Correct the policy and repeat"
    if directory is None:
        usual = changed = "Nothing is kept: a run with an output directory could be resumed."
    else:
        repeat += " the command with --fresh; or --resume plays this same policy on"
    advice = {errors.HopelessRunError: repeat, errors.CheckpointChangedError: changed}
    try:
        yield
    except (errors.InfrastructureError, errors.RunDirectoryError) as error:
        raise errors.InfrastructureError(f"{error}\n{usual}") from error
    except (*advice, errors.OutOfMemoryError) as error:
        raise type(error)(f"{error}\n{advice.get(type(error), usual)}") from error
    except KeyboardInterrupt as error:
        raise errors.InterruptedRunError(f"interrupted\n{usual}") from error
