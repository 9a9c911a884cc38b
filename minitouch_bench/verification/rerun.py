"""Drawn episodes of a run once more with its checkpoint: the same bits, or where they part."""

from collections.abc import Iterator, Sequence

import numpy as np

from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.actions import Actions
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.evaluation.engine import Engine
from minitouch_bench.policies.sources import PolicySource, identify
from minitouch_bench.records import EpisodeMetrics, EpisodeRecord, EpisodeSpec, PolicyIdentity
from minitouch_bench.verification.problems import Problem
from minitouch_bench.verification.recorded_run import RecordedRun


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
