"""Prove a submission: replay its recorded actions, and run drawn episodes with its checkpoint."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.evaluation.engine import Engine
from minitouch_bench.leaderboard.submission import CHECKPOINTS, TrainingSeed
from minitouch_bench.leaderboard.validation import Verdict
from minitouch_bench.policies.isolation.options import IsolationOptions, limits_of
from minitouch_bench.policies.loading import BUILT_IN
from minitouch_bench.policies.sources import DIRECTORY, PolicySource, parse_source
from minitouch_bench.records import EpisodeRecord, PolicyIdentity, Role
from minitouch_bench.verification.problems import Problems
from minitouch_bench.verification.recorded_run import RecordedRun, open_run
from minitouch_bench.verification.verify import check_identity, draw_episodes, rerun, verify_run

NOT_REPLAYED = "the recorded actions do not give these figures"
NOT_REPEATED = "the checkpoint does not act as recorded"


@dataclass(frozen=True)
class Proving:
    """How to prove: on which engine, drawing from ``rng``, and what takes each episode."""

    engine: Engine
    rng: np.random.Generator = field(default_factory=np.random.default_rng)
    on_record: Callable[[EpisodeRecord], None] = lambda _: None


def replay(verdict: Verdict, proving: Proving) -> Problems:
    """Replay the actions of every run; each difference is a problem. No checkpoint is opened."""
    problems = Problems()
    for place in verdict.runs:
        with problems.caught(place):
            found = verify_run(verdict.directory / place, proving.engine, proving.on_record)
            for problem in found.problems:
                problems.add_below(place, replace(problem, remedy=problem.remedy or NOT_REPLAYED))
    return problems


def run_again(verdict: Verdict, count: int, proving: Proving) -> Problems:
    """Run ``count`` drawn episodes of each run with the checkpoint, held in the sandbox."""
    problems = Problems()
    assert verdict.submission is not None
    for seed in verdict.submission.seeds:
        for place in seed.runs.values():
            with problems.caught(place):
                _run_again(verdict.directory, seed, place, count, proving, problems)
    return problems


def _run_again(  # noqa: PLR0917 - one run of one seed of a submission
    directory: Path,
    seed: TrainingSeed,
    place: str,
    count: int,
    proving: Proving,
    problems: Problems,
) -> None:
    run, found = open_run(directory / place)
    for problem in found:
        problems.add_below(place, problem)
    if run is None:
        return
    setup = _setup(directory, seed, run)
    specs = draw_episodes(run, count, proving.rng)
    for record, differing in rerun(run, setup, specs, proving.engine):
        proving.on_record(record)
        for problem in differing:
            problems.add_below(place, replace(problem, remedy=NOT_REPEATED))


def _setup(directory: Path, seed: TrainingSeed, run: RecordedRun) -> PolicySetup:
    header = run.saved.header
    exploration = header.exploration
    return PolicySetup(
        _source(directory, seed, Role.FINAL, header.policy),
        None if exploration is None else _source(directory, seed, Role.EXPLORATION, exploration),
        IsolationOptions(limits=limits_of(header)),
    )


def _source(
    directory: Path, seed: TrainingSeed, role: Role, recorded: PolicyIdentity
) -> PolicySource:
    """Find a policy's checkpoint in the submission.

    Raises:
        UsageError: it is not there, or is another one.
        PolicyLoadError: it cannot be read.
    """
    files = seed.files(role)
    if recorded.kind in BUILT_IN:
        return parse_source(recorded.kind)
    if not files or not all(file.path for file in files):
        raise UsageError(
            f"the {role} checkpoint of seed {seed.seed} is not in the submission: "
            "it cannot be run again"
        )
    places = directory / CHECKPOINTS / f"seed-{seed.seed}" / role.value
    path = places if recorded.kind == DIRECTORY else directory / files[0].path
    source = parse_source(str(path))
    check_identity(recorded, source)
    return source
