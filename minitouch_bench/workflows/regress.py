"""Hold a candidate to its baseline; a policy is played no longer than the answer needs."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.actors import prepare_policies
from minitouch_bench.evaluation.engine import LOCAL, Engine, EngineOptions, open_engine
from minitouch_bench.evaluation.rollout import ActorSource
from minitouch_bench.evaluation.run import OpenRun, RunRequest, open_run
from minitouch_bench.evaluation.suites import choose_tasks, find_suite
from minitouch_bench.files import REPORTS, append_text, lock_directory, write_file
from minitouch_bench.metrics.summary import measure
from minitouch_bench.policies.isolation.options import SANDBOXED, IsolationOptions
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import (
    EpisodeRecord,
    EpisodeSpec,
    EvaluationRun,
    Outcome,
    PolicyIdentity,
    Role,
    SavedRun,
)
from minitouch_bench.regression.comparison import ComparedRun
from minitouch_bench.regression.gate import GateResult, judge_runs
from minitouch_bench.regression.pairing import episode_key
from minitouch_bench.regression.sequential import (
    SequentialGate,
    early_result,
    final_result,
    play_order,
)
from minitouch_bench.regression.settings import STANDARD, GateSettings
from minitouch_bench.regression.writers import gate_junit, gate_markdown
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.run_directory import read_run
from minitouch_bench.workflows import SILENT, Callbacks
from minitouch_bench.workflows.evaluate import OutputOptions, play, run_name, save_run


@dataclass(frozen=True)
class RegressOptions:
    """What to hold to which baseline: either a ``policy``, or a finished run as ``candidate``.

    ``engine``, ``isolation`` and ``output`` are of the policy. ``junit`` gets JUnit XML, and
    Markdown is added to ``summary``.
    """

    baseline: Path
    policy: object | None = None
    candidate: Path | None = None
    settings: GateSettings = STANDARD
    engine: EngineOptions = LOCAL
    isolation: IsolationOptions = SANDBOXED
    output: OutputOptions = field(default_factory=OutputOptions)
    junit: Path | None = None
    summary: Path | None = None


def regress(options: RegressOptions, callbacks: Callbacks = SILENT) -> GateResult:
    """Judge a candidate beside its baseline, and write the files asked for.

    A policy plays the baseline's episodes until the answer is certain, or all of them; its run
    is kept in its directory.

    Raises:
        UsageError: an option has no meaning, or the runs are not of the same episodes.
        PolicyError, IsolationError, MissingExtraError: the policy cannot be used.
        RunDirectoryError: a directory is in use, holds another run, or none.
        InfrastructureError, InterruptedRunError: the run is incomplete and can be resumed.
    """
    baseline = read_run(options.baseline)
    if options.candidate is not None:
        paths = (str(options.baseline), str(options.candidate))
        result = judge_runs(baseline, read_run(options.candidate), paths, options.settings)
    elif options.policy is not None:
        result = _play_gate(baseline, options.policy, options, callbacks)
    else:
        raise UsageError("there is nothing to judge: give a policy or a candidate's run")
    if options.junit is not None:
        write_file(options.junit, gate_junit(result))
    if options.summary is not None:
        append_text(options.summary, gate_markdown(result))
    return result


class _EnoughError(Exception):
    """The answer is certain; the other episodes need not be played."""


class _InOrder:
    """An engine that starts the episodes in another order."""

    def __init__(self, engine: Engine, order: Sequence[str]) -> None:
        self.workers = engine.workers
        self._engine = engine
        self._turns = {key: turn for turn, key in enumerate(order)}

    def run(
        self, source: ActorSource, specs: Sequence[EpisodeSpec], attempts: Path | None = None
    ) -> Iterator[EpisodeRecord]:
        """Yield what the engine yields; closing this closes that."""
        ordered = sorted(specs, key=lambda spec: self._turns[spec.key])
        yield from self._engine.run(source, ordered, attempts)


def _play_gate(
    baseline: SavedRun, policy: object, options: RegressOptions, callbacks: Callbacks
) -> GateResult:
    """Play the baseline's episodes until the answer is certain, or all."""
    opening = open_engine(options.engine, callbacks.note)
    baseline, left_out = _playable(baseline, callbacks)
    request = _request_like(baseline, policy, options.isolation, callbacks)
    path, output = str(options.baseline), options.output
    directory = output.directory or REPORTS / f"{run_name(request)}-regress"
    root = (baseline.header.seed,)
    order = play_order(baseline.episodes, root)
    gate = SequentialGate(order, options.settings, root)
    with opening as engine, lock_directory(directory):
        opened = open_run(request, directory, resume=output.resume, fresh=output.fresh)
        turns = [episode_key(Role.FINAL, episode) for episode in order]
        run = _play(request, opened, _InOrder(engine, turns), gate, callbacks)
        saved = None if run is None else save_run(run, directory).saved
    if saved is not None and not gate.is_certain:
        result = final_result(baseline, saved, (path, str(directory)), options.settings)
    else:
        header = request.header()
        name, labels = printable(header.policy.name), _labels(header.policy, gate)
        candidate = ComparedRun("candidate", name, str(directory), labels)
        result = early_result(gate, baseline, path, candidate, header)
    return replace(result, left_out=left_out)


def _playable(baseline: SavedRun, callbacks: Callbacks) -> tuple[SavedRun, tuple[str, ...]]:
    """Return what a policy can be held to, and the tasks whose rules have changed."""
    header = baseline.header
    suite_tasks = choose_tasks(header.tasks, find_suite(header.suite))
    tasks = tuple(
        task for task in suite_tasks if PROTOCOL.task_digest(task) == header.task_digests.get(task)
    )
    left_out = tuple(task for task in suite_tasks if task not in tasks)
    if not tasks:
        raise UsageError(
            f"the rules of {', '.join(left_out)} are others than when '{printable(baseline.name)}' "
            "was made: make the baseline again"
        )
    if baseline.exploration_episodes:
        callbacks.note("the baseline's exploration episodes are left out: POLICY has none")
    kept = replace(
        baseline,
        header=replace(header, tasks=tasks),
        episodes=tuple(one for one in baseline.episodes if one.task in tasks),
        exploration_episodes=(),
    )
    return kept, left_out


def _request_like(
    baseline: SavedRun, policy: object, isolation: IsolationOptions, callbacks: Callbacks
) -> RunRequest:
    """Return the request that plays a policy on the baseline's episodes.

    Raises:
        UsageError: the baseline does not hold the episodes that its header says.
        PolicyError: the policy cannot be used.
    """
    header = baseline.header
    setup = prepare_policies(
        policy, header.tasks, isolation, callbacks.note, conditions=header.played_under
    )
    suite = find_suite(header.suite)
    request = RunRequest(suite, header.tasks, header.episodes, header.seed, setup, header.chosen)
    found = {episode_key(Role.FINAL, one): (one.seed, one.shape) for one in baseline.episodes}
    expected = {spec.key: (spec.seed, spec.shape) for spec in request.specs()}
    if found != expected or len(baseline.episodes) != len(expected):
        raise UsageError(
            f"'{printable(baseline.name)}' does not hold the {len(expected)} episodes of its "
            "suite, tasks and seed; make the baseline again"
        )
    return request


def _play(
    request: RunRequest, opened: OpenRun, engine: Engine, gate: SequentialGate, callbacks: Callbacks
) -> EvaluationRun | None:
    """Play until the gate is certain; return the run if it is whole."""
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
        return play(request, opened, engine, replace(callbacks, episode=take))
    return None


def _labels(policy: PolicyIdentity, gate: SequentialGate) -> tuple[str, ...]:
    """Return what must be known of a policy whose run was stopped."""
    faults = sum(pair.second.outcome is Outcome.POLICY_FAULT for pair in gate.pairs)
    found = [printable(note) for note in policy.notes]
    if faults:
        found.append(f"{faults} policy {'fault' if faults == 1 else 'faults'}")
    return tuple(found)
