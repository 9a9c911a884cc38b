"""Play a policy on the episodes of a baseline, no longer than the answer needs."""

import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from minitouch_bench.errors import RunDirectoryError, UsageError, printable
from minitouch_bench.evaluation.actors import PolicySetup, prepare_policies
from minitouch_bench.evaluation.engine import Engine, EngineOptions, open_engine
from minitouch_bench.evaluation.run import RunUnderWay, header_of, open_run, run_name
from minitouch_bench.files import REPORTS, lock_directory
from minitouch_bench.metrics.summary import measure
from minitouch_bench.policies.isolation.options import IsolationOptions
from minitouch_bench.records import EpisodeRecord, Role
from minitouch_bench.regression.gate import (
    EpisodesUsed,
    GateResult,
    endpoint_values,
    judge_runs,
    refuse_other_rules,
)
from minitouch_bench.regression.pairing import EpisodePair, episode_key
from minitouch_bench.regression.sequential import SequentialGate
from minitouch_bench.regression.settings import GateSettings
from minitouch_bench.reporting.labels import tasks_in_order
from minitouch_bench.runs.run import Run, read_run, run_digest
from minitouch_bench.workflows import Callbacks
from minitouch_bench.workflows.playing import play, write_views


def read_unedited(directory: Path) -> Run:
    """Read a run whose digest is that of its episodes.

    Raises:
        RunDirectoryError: it is not a run, or was edited.
    """
    run = read_run(directory)
    if run.is_edited():
        raise RunDirectoryError(
            f"{directory} was edited: its digest is not that of its episodes; make the run again"
        )
    return run


class _EnoughError(Exception):
    """The answer is certain; the other episodes need not be played."""


def play_gate(
    baseline: Run,
    path: str,
    policy: object,
    settings: GateSettings,
    *,
    engine: EngineOptions,
    isolation: IsolationOptions,
    output: Path | None,
    resume: bool,
    fresh: bool,
    callbacks: Callbacks,
) -> GateResult:
    """Play the baseline's episodes until the answer is certain, or all.

    Raises:
        MiniTouchError: see ``regress``.
    """
    opening = open_engine(engine, callbacks.note)
    whole, baseline = baseline, _deciding_part(baseline, settings)
    setup = _prepare_like(baseline, policy, isolation, callbacks)
    if left_out := [task for task in whole.plan.tasks if task not in setup.plan.tasks]:
        callbacks.note(f"{', '.join(left_out)} of the baseline decide nothing and are not played")
    if whole.exploration_episodes:
        callbacks.note("the baseline's exploration episodes are left out: POLICY has none")
    directory = output or REPORTS / f"{run_name(setup)}-regress"
    gate = SequentialGate(baseline, settings)
    clock = time.monotonic()
    with opening as running, lock_directory(directory):
        opened = open_run(setup, directory, resume=resume, fresh=fresh)
        run = _play(setup, opened, running, gate, callbacks)
        if run is not None:
            write_views(run, directory)
    if run is not None:
        result = judge_runs(baseline, run, (path, str(directory)), settings)
        used = EpisodesUsed(gate.planned, gate.planned, "no answer was certain before the end")
        return replace(result, episodes_used=used)
    wall_s = round(time.monotonic() - clock, 3)
    return gate.result(path, str(directory), header_of(setup), wall_s)


def _deciding_part(baseline: Run, settings: GateSettings) -> Run:
    """Return the baseline with the episodes that decide: a policy plays no others.

    Raises:
        UsageError: none can.
    """
    pairs = [EpisodePair(Role.FINAL, one, one) for one in baseline.episodes]
    tasks = endpoint_values(pairs, tasks_in_order((baseline,)), settings).tasks
    episodes = tuple(one for one in baseline.episodes if one.task in tasks)
    chosen = tuple(key for key in baseline.plan.chosen if key.partition("/")[0] in tasks)
    header = replace(baseline.header, plan=replace(baseline.plan, tasks=tasks, chosen=chosen))
    return replace(
        baseline,
        digest=run_digest(header, episodes),
        header=header,
        episodes=episodes,
        exploration_episodes=(),
    )


def _prepare_like(
    baseline: Run, policy: object, isolation: IsolationOptions, callbacks: Callbacks
) -> PolicySetup:
    """Load a policy to play the baseline's episodes.

    Raises:
        UsageError: the baseline has other rules, or not the episodes that its header says.
        PolicyError: the policy cannot be used.
    """
    plan = replace(baseline.plan, limits=isolation.limits)
    name, mistake = plan.mistake()
    if name:
        raise UsageError(f"'{printable(baseline.name)}', header.plan.{name}: {printable(mistake)}")
    setup = prepare_policies(policy, plan, isolation, callbacks.note)
    refuse_other_rules(baseline, header_of(setup))
    recorded = {episode_key(Role.FINAL, row): (row.seed, row.shape) for row in baseline.episodes}
    planned = {spec.key: (spec.seed, spec.shape) for spec in plan.specs()}
    if recorded != planned or len(baseline.episodes) != len(planned):
        raise UsageError(
            f"'{printable(baseline.name)}' does not contain the {len(planned)} episodes of its "
            "suite, tasks and seed; make the baseline again"
        )
    return setup


def _play(
    setup: PolicySetup,
    opened: RunUnderWay | Run,
    engine: Engine,
    gate: SequentialGate,
    callbacks: Callbacks,
) -> Run | None:
    """Play until the gate is certain; return the run if it is whole."""
    if isinstance(opened, Run):
        gate.add(opened.episodes)
        return opened
    gate.add(measure(record) for record in opened.records)
    if gate.is_certain and len(opened.records) < gate.planned:
        return None
    seen = {record.spec for record in opened.records}

    def take(record: EpisodeRecord) -> None:
        callbacks.episode(record)
        is_new = record.spec not in seen
        if is_new and gate.add([measure(record)]) and gate.used < gate.planned:
            raise _EnoughError

    with suppress(_EnoughError):
        return play(setup, opened, engine, replace(callbacks, episode=take), turn=gate.turn)
    return None
