"""A run checked without trust: its actions replayed, and drawn episodes run again."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from minitouch_bench.episode import Episode, EpisodeSpec, Outcome, PlayedEpisode, Role
from minitouch_bench.errors import IncompleteCheckError, UsageError
from minitouch_bench.evaluation.engine import Engine, Note
from minitouch_bench.evaluation.policy_setup import PolicySetup, Recording, prepare_policies
from minitouch_bench.metrics.summary import measure, with_curves
from minitouch_bench.policies.policy import SANDBOXED, IsolationOptions
from minitouch_bench.protocol.limits import USUAL_LIMITS
from minitouch_bench.runs.actions import Actions
from minitouch_bench.runs.run import Run
from minitouch_bench.text import numbered
from minitouch_bench.verification.static_check import Problem


@dataclass(frozen=True)
class Findings:
    """What a check found: its problems, and how many episodes it played.

    ``replayed``: from their recorded actions; ``reran``: with the checkpoint.
    """

    problems: tuple[Problem, ...] = ()
    replayed: int = 0
    reran: int = 0

    @property
    def passed(self) -> bool:
        """Whether everything is as recorded."""
        return not self.problems


def replay_run(
    run: Run, engine: Engine, on_record: Callable[[PlayedEpisode], None] = lambda _: None
) -> Findings:
    """Replay every episode of a run that ``check_run`` passes; ``on_record`` takes them.

    The episodes come from the plan, the actions from ``actions.npz``. Every metric and digest of
    the replayed trajectories is compared bit for bit. The texts of faults, and what the policy and
    the machine were called, cannot be recomputed and are taken as they are.

    Raises:
        RunDirectoryError: a file of it is missing or damaged.
        InfrastructureError: an episode could not be replayed.
    """
    specs = run.header.specs()
    records = play_all(Recording.of(run, specs), specs, engine, on_record)
    return Findings(tuple(_compare(run, records)), replayed=len(records))


def _compare(run: Run, records: dict[EpisodeSpec, PlayedEpisode]) -> Iterator[Problem]:
    """Compare the rows of a run, and its curves over time, with its replayed episodes."""
    differs = False
    for spec, row in run.specs_and_rows():
        given, used = len(run.actions[spec.key]), len(records[spec].trace.actions)
        if given != used:
            yield Problem(spec.key, f"{given} actions recorded, the episode ends after {used}")
        again = measure(_with_claims(records[spec], row))
        names = [f.name for f in fields(row) if getattr(row, f.name) != getattr(again, f.name)]
        if names:
            differs = True
            what = f"its actions do not give the episode recorded: other {', '.join(names)}"
            yield Problem(spec.key, what)
    again_summary = run.summary if differs else with_curves(run.summary, [*records.values()])
    for task, replayed in zip(run.summary.tasks, again_summary.tasks, strict=True):
        if task != replayed:
            yield Problem(f"curves of {task.task}", "they are not those of the episodes")


def _with_claims(record: PlayedEpisode, row: Episode) -> PlayedEpisode:
    """Add to a replayed episode what only the policy's own process knew.

    The recorded actions are clipped already. A clipped one has a component of exactly -1 or
    1: so many at most are taken from what the row claims.
    """
    at_bounds = np.flatnonzero((np.abs(record.trace.actions) == 1).any(axis=1))
    clipped = np.zeros(len(record.trace.actions), np.bool_)
    clipped[at_bounds[: row.clipped_actions]] = True
    return replace(record, trace=replace(record.trace, clipped=clipped))


def is_as_recorded(run: Run, replayed: PlayedEpisode) -> bool:
    """Say whether the bits and the outcome of a replayed episode are those of the run's row."""
    _, row = run.find(replayed.spec.key)
    return (replayed.trace.digest(), replayed.outcome) == (row.digest, row.outcome)


def draw_episodes(run: Run, count: int, rng: np.random.Generator) -> tuple[EpisodeSpec, ...]:
    """Draw so many episodes of each policy of a run, in its order; nobody may foresee ``rng``."""
    drawn: list[EpisodeSpec] = []
    for role in Role:
        specs = [spec for spec in run.header.specs() if spec.role is role]
        size = min(count, len(specs))
        drawn += (specs[i] for i in sorted(rng.choice(len(specs), size, replace=False)))
    return tuple(drawn)


def prepare_rerun(
    run: Run,
    policy: object,
    exploration: object | None = None,
    isolation: IsolationOptions = SANDBOXED,
    note: Note = lambda _: None,
) -> PolicySetup:
    """Load the checkpoints of a run, for its conditions, and see that they are its own.

    Its limits hold as far as they are within the official ones: the run's maker does not decide
    how much time and memory of this machine a policy gets. In an episode none of them can read the
    run, whose actions it could repeat.

    Raises:
        UsageError: a checkpoint is another one.
        PolicyError, IsolationError, MissingExtraError: a checkpoint cannot be used.
    """
    explorer = None if run.header.exploration is None else exploration
    plan = replace(run.plan, limits=run.plan.limits.within(USUAL_LIMITS))
    if plan != run.plan:
        note("the run's own limits of time and memory exceed the official ones, which hold here")
    setup = prepare_policies(policy, plan, isolation, note, exploration=explorer)
    for recorded, source in zip(run.header.policies(), setup.sources(), strict=True):
        there, here = (recorded.kind, recorded.digest), (source.kind, source.digest)
        if there != here:
            known, found = (f"{kind} {digest[:12]}".rstrip() for kind, digest in (there, here))
            what = f"is not the policy of this run: {found}, the run's is {known}"
            raise UsageError(f"{source.target} {what}")
    return setup if run.directory is None else setup.keep_out_of(run.directory)


def run_again(
    run: Run,
    setup: PolicySetup,
    specs: Sequence[EpisodeSpec],
    engine: Engine,
    on_record: Callable[[PlayedEpisode], None] = lambda _: None,
) -> Findings:
    """Run these episodes with the checkpoint; ``on_record`` takes them.

    A fault of the policy in an episode that the run says went well is a difference: what fails
    where the record is forged could otherwise be tried until no such episode is drawn. An episode
    without an answer in time is run once more; it is a difference too, unless most episodes are so.

    Raises:
        IncompleteCheckError: the policy is too slow on this machine, or does not repeat a fault.
        InfrastructureError: an episode failed three times for no fault of the policy.
    """
    records = play_all(setup, specs, engine, on_record)
    late = [spec for spec, record in records.items() if record.is_late]
    records |= play_all(setup, late, engine, lambda _: None)
    late = [spec for spec in late if records[spec].is_late]
    rows = dict(run.specs_and_rows())
    problems: list[Problem] = []
    unsaid = []
    for spec, record in records.items():
        row = rows[spec]
        found = tuple(_differences(record, row, run.actions[spec.key]))
        failed_then = row.outcome is Outcome.POLICY_FAULT
        if found and (failed_then or (record.is_late and 2 * len(late) > len(records))):
            unsaid.append(f"{spec.key}: {record.fault or 'the recorded fault is not repeated'}")
        else:
            problems += found
    if unsaid and not problems:
        raise IncompleteCheckError(
            f"{run.place}: {len(unsaid)} of {len(records)} episodes cannot be compared; {unsaid[0]}"
        )
    return Findings(tuple(problems), reran=len(records))


def play_all(
    setup: PolicySetup | Recording,
    specs: Sequence[EpisodeSpec],
    engine: Engine,
    on_record: Callable[[PlayedEpisode], None],
) -> dict[EpisodeSpec, PlayedEpisode]:
    """Play episodes and return their records in the order of ``specs``."""
    records: dict[EpisodeSpec, PlayedEpisode] = {}
    for record in engine.run(setup, specs) if specs else ():
        records[record.spec] = record
        on_record(record)
    return {spec: records[spec] for spec in specs}


def _differences(record: PlayedEpisode, row: Episode, recorded: Actions) -> Iterator[Problem]:
    key = record.spec.key
    if record.outcome is not row.outcome:
        fault = f" ({record.fault})" if record.fault else ""
        yield Problem(key, f"{row.outcome} recorded, {record.outcome} when run again{fault}")
    elif record.trace.digest() != row.digest:
        yield Problem(key, _first_other_step(recorded, record.trace.actions))
    elif (clipped := int(record.trace.clipped.sum())) != row.clipped_actions:
        what = f"{row.clipped_actions} clipped actions recorded, {clipped} when run again"
        yield Problem(key, what)


def _first_other_step(recorded: Actions, again: Actions) -> str:
    for step, (action, other) in enumerate(zip(recorded, again, strict=False)):
        if action.tobytes() != other.tobytes():
            return f"action {step} was {action.tolist()}, when run again {other.tolist()}"
    if len(recorded) != len(again):
        return f"{numbered(len(recorded), 'step')} recorded, {len(again)} when run again"
    return "the actions are the same, the trajectory is not: is it the same processor?"
