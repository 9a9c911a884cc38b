"""A policy played against a baseline's episodes, until the gate's answer is certain."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from minitouch_bench.cli.consoles import notes
from minitouch_bench.cli.progress import EpisodeProgress
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.engine import Engine, EngineHandle
from minitouch_bench.evaluation.rollout import ActorSource
from minitouch_bench.evaluation.run import OpenRun, RunRequest, open_run
from minitouch_bench.evaluation.suites import choose_tasks, find_suite
from minitouch_bench.files import lock_directory
from minitouch_bench.metrics import measure
from minitouch_bench.policies.isolation.options import IsolationOptions
from minitouch_bench.records import (
    EpisodeRecord,
    EpisodeSpec,
    EvaluationRun,
    Outcome,
    PolicyIdentity,
    Role,
    SavedRun,
)
from minitouch_bench.regression.gate import Side, Verdict, final_episodes
from minitouch_bench.regression.pairing import episode_key, refuse_other_rules
from minitouch_bench.regression.sequential import SequentialGate, play_order
from minitouch_bench.regression.tolerances import GateSettings
from minitouch_bench.regression.verdicts import early_verdict, final_verdict
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.workflows.callbacks import Callbacks
from minitouch_bench.workflows.evaluate import play, run_name, save_run
from minitouch_bench.workflows.policies import prepare_policies


@dataclass(frozen=True)
class PlaySettings:
    """How a policy is played: where its run is kept, and by which engine."""

    directory: Path | None
    handle: EngineHandle
    resume: bool
    fresh: bool


class _EnoughError(Exception):
    """The answer is certain; the other episodes need not be played."""


class _InOrder:
    """An engine that starts the episodes in another order."""

    def __init__(self, engine: Engine, order: Sequence[str]) -> None:
        self._engine = engine
        self._places = {key: place for place, key in enumerate(order)}

    def run(self, source: ActorSource, specs: Sequence[EpisodeSpec]) -> Iterator[EpisodeRecord]:
        """Yield what the engine yields; closing this closes that."""
        ordered = sorted(specs, key=lambda spec: self._places[spec.key])
        yield from self._engine.run(source, ordered)


def request_like(baseline: SavedRun, policy: str, isolation: IsolationOptions) -> RunRequest:
    """Return the request that plays a policy on the baseline's episodes.

    Raises:
        UsageError: this version has no such suite, or another protocol, or the baseline does
            not hold the episodes that its header says.
        PolicyError: the policy cannot be used.
    """
    header = baseline.header
    suite = find_suite(header.suite)
    tasks = choose_tasks(header.tasks, suite)
    setup = prepare_policies(policy, tasks, isolation)
    request = RunRequest(suite, tasks, header.episodes, header.seed, setup)
    refuse_other_rules(header, request.header(), (baseline.name, setup.policy.name))
    _refuse_other_episodes(baseline, request)
    return request


def play_gate(
    baseline: SavedRun,
    baseline_place: str,
    request: RunRequest,
    settings: GateSettings,
    options: PlaySettings,
) -> Verdict:
    """Play episodes until the answer is certain, or all; the run is kept in its directory.

    Raises:
        RunDirectoryError: the directory is in use, or holds another run.
        InfrastructureError, InterruptedRunError: broken off; what is done is kept.
    """
    if baseline.exploration_episodes:
        notes.print("the baseline's exploration episodes are left out: POLICY has none")
        baseline = final_episodes(baseline)
    directory = options.directory or Path("reports") / f"{run_name(request)}-regress"
    root = (baseline.header.seed,)
    order = play_order(baseline.episodes, root)
    gate = SequentialGate(order, settings, root)
    with lock_directory(directory):
        run = _play(
            request, gate, [episode_key(Role.FINAL, one) for one in order], directory, options
        )
        saved = None if run is None else save_run(run, directory).saved
    if saved is not None and not gate.is_certain:
        return final_verdict(baseline, saved, (baseline_place, str(directory)), settings)
    header = request.header()
    candidate = Side(printable(header.policy.name), str(directory), _labels(header.policy, gate))
    return early_verdict(gate, baseline, baseline_place, candidate, header)


def _refuse_other_episodes(baseline: SavedRun, request: RunRequest) -> None:
    found = {episode_key(Role.FINAL, one): (one.seed, one.shape) for one in baseline.episodes}
    expected = len(request.tasks) * request.episodes
    if len(found) == len(baseline.episodes) == expected:
        specs = request.specs()
        if found == {spec.key: (spec.seed, spec.shape) for spec in specs}:
            return
    raise UsageError(
        f"'{printable(baseline.name)}' does not hold the {expected} episodes of its suite, "
        "tasks and seed; make the baseline anew"
    )


def _play(
    request: RunRequest,
    gate: SequentialGate,
    order: Sequence[str],
    directory: Path,
    options: PlaySettings,
) -> EvaluationRun | None:
    """Play into a locked directory; return the run if it is whole."""
    opened = open_run(request, directory, resume=options.resume, fresh=options.fresh)
    gate.add(measure(record) for record in opened.records)
    if gate.is_certain and len(opened.records) < gate.planned:
        return None
    handle = replace(options.handle, engine=_InOrder(options.handle.engine, order))
    with suppress(_EnoughError), EpisodeProgress(notes) as progress:
        return play(request, opened, handle, _stopping(gate, opened, progress.callbacks))
    return None


def _stopping(gate: SequentialGate, opened: OpenRun, callbacks: Callbacks) -> Callbacks:
    """Return callbacks that add each new episode to the gate, and end the run where it is sure."""
    seen = {record.spec for record in opened.records}

    def take(record: EpisodeRecord) -> None:
        callbacks.episode(record)
        if record.spec in seen:
            return
        if gate.add([measure(record)]) and gate.used < gate.planned:
            raise _EnoughError

    return replace(callbacks, episode=take)


def _labels(policy: PolicyIdentity, gate: SequentialGate) -> tuple[str, ...]:
    """Return what must be known of a policy whose run was stopped."""
    faults = sum(pair.second.outcome is Outcome.POLICY_FAULT for pair in gate.pairs)
    found = [printable(note) for note in policy.notes]
    if faults:
        found.append(f"{faults} policy {'fault' if faults == 1 else 'faults'}")
    return tuple(found)
