"""A run checked without trust: its actions replayed, and drawn episodes run again."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.actors import PolicySetup, Recording, prepare_policies
from minitouch_bench.evaluation.engine import Engine, Note
from minitouch_bench.metrics.summary import measure, touch_curve
from minitouch_bench.policies.isolation.options import SANDBOXED, IsolationOptions
from minitouch_bench.policies.sources import PolicySource, identify
from minitouch_bench.records import EpisodeMetrics, EpisodeRecord, EpisodeSpec, PolicyIdentity, Role
from minitouch_bench.runs.actions import Actions
from minitouch_bench.runs.run import Run
from minitouch_bench.verification.problems import Problem


@dataclass(frozen=True)
class Verification:
    """A check's result; ``reran``: episodes run with the policy, drawn with the seed ``draw``."""

    episodes: int
    problems: tuple[Problem, ...]
    reran: int = 0
    draw: int | None = None

    @property
    def passed(self) -> bool:
        """Whether everything is as recorded."""
        return not self.problems


def replay_run(
    run: Run, engine: Engine, on_record: Callable[[EpisodeRecord], None] = lambda _: None
) -> Verification:
    """Replay every episode of a run that ``check_run`` passes; ``on_record`` takes them.

    The episodes come from the plan, the actions from ``actions.npz``. Every estimate is computed
    again and compared up to ROUNDING, every metric and digest of the replayed trajectories bit
    for bit. The texts of faults, and what the policy and the machine were called, cannot be
    recomputed and are taken as they are.

    Raises:
        RunDirectoryError: a file of it is missing or damaged.
        InfrastructureError: an episode could not be replayed.
    """
    records: dict[EpisodeSpec, EpisodeRecord] = {}
    for record in engine.run(Recording(run.actions, run.plan.conditions), run.header.specs()):
        records[record.spec] = record
        on_record(record)
    return Verification(len(records), tuple(_compare(run, records)))


def _compare(run: Run, records: dict[EpisodeSpec, EpisodeRecord]) -> Iterator[Problem]:
    """Compare the rows of a run, and its touch curves, with its replayed episodes."""
    differs = False
    for spec, row in run.rows():
        given, used = len(run.actions[spec.key]), len(records[spec].trace.actions)
        if given != used:
            yield Problem(spec.key, f"{given} actions recorded, the episode ends after {used}")
        again = measure(_with_claims(records[spec], row))
        names = [f.name for f in fields(row) if getattr(row, f.name) != getattr(again, f.name)]
        if names:
            differs = True
            what = f"its actions do not give the episode recorded: other {', '.join(names)}"
            yield Problem(spec.key, what)
    final = [records[spec] for spec in run.header.specs() if spec.role is Role.FINAL]
    for task in () if differs else run.summary.tasks:
        if (task.touch_curve, task.touch_curve_episodes) != touch_curve(final, task.task):
            yield Problem(f"touch curve of {task.task}", "it is not that of the episodes")


def _with_claims(record: EpisodeRecord, row: EpisodeMetrics) -> EpisodeRecord:
    """Add to a replayed episode what only the policy's own process knew.

    The recorded actions are clipped already. A clipped one has a component of exactly -1 or
    1: so many at most are taken from what the row claims.
    """
    at_bounds = np.flatnonzero((np.abs(record.trace.actions) == 1).any(axis=1))
    clipped = np.zeros(len(record.trace.actions), np.bool_)
    clipped[at_bounds[: row.clipped_actions]] = True
    return replace(record, trace=replace(record.trace, clipped=clipped))


def draw_episodes(run: Run, count: int, rng: np.random.Generator) -> tuple[EpisodeSpec, ...]:
    """Draw so many episodes of each policy of a run, in its order; nobody may foresee ``rng``."""
    drawn: list[EpisodeSpec] = []
    for role in Role:
        specs = [spec for spec in run.header.specs() if spec.role is role]
        size = min(count, len(specs))
        drawn += (specs[i] for i in sorted(rng.choice(len(specs), size, replace=False)))
    return tuple(drawn)


def check_identity(recorded: PolicyIdentity, source: PolicySource) -> None:
    """Refuse a checkpoint that is not the one evaluated.

    Raises:
        UsageError: its kind or its bytes are others.
    """
    identity = identify(source)
    if (identity.kind, identity.digest) != (recorded.kind, recorded.digest):
        raise UsageError(
            f"{source.target} is not the policy of this run: {_in_words(identity)}, "
            f"the run's is {_in_words(recorded)}"
        )


def prepare_rerun(
    run: Run,
    policy: object,
    exploration: object | None = None,
    isolation: IsolationOptions = SANDBOXED,
    note: Note = lambda _: None,
) -> PolicySetup:
    """Load the checkpoints of a run, for its conditions and limits, and see that they are its own.

    In an episode none of them can read the run, whose actions it could repeat.

    Raises:
        UsageError: a checkpoint is another one.
        PolicyError, IsolationError, MissingExtraError: a checkpoint cannot be used.
    """
    explorer = None if run.header.exploration is None else exploration
    setup = prepare_policies(policy, run.plan, isolation, note, exploration=explorer)
    for recorded, source in zip(run.header.policies(), setup.sources(), strict=True):
        check_identity(recorded, source)
    return setup if run.directory is None else setup.keep_out_of(run.directory)


def rerun(
    run: Run, setup: PolicySetup, specs: Sequence[EpisodeSpec], engine: Engine
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
    key = record.spec.key
    if record.outcome is not row.outcome:
        yield Problem(key, f"{row.outcome} recorded, {record.outcome} when run again")
    elif record.trace.digest() != row.digest:
        yield Problem(key, _first_other_step(recorded, record.trace.actions))


def _first_other_step(recorded: Actions, again: Actions) -> str:
    for step, (action, other) in enumerate(zip(recorded, again, strict=False)):
        if action.tobytes() != other.tobytes():
            return f"action {step} was {action.tolist()}, when run again {other.tolist()}"
    if len(recorded) != len(again):
        return f"{len(recorded)} steps recorded, {len(again)} when run again"
    return "the actions are the same, the trajectory is not: is it the same processor?"


def _in_words(identity: PolicyIdentity) -> str:
    return f"{identity.kind} {identity.digest[:12]}".rstrip()
