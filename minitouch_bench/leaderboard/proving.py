"""Prove a submission: replay its actions, run drawn and fresh episodes with its checkpoint."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from minitouch_bench.errors import IncompleteCheckError
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.evaluation.engine import Engine
from minitouch_bench.evaluation.suites import find_suite
from minitouch_bench.leaderboard.proof import FreshProof
from minitouch_bench.leaderboard.submission import CHECKPOINTS, MAIN_SUITE, TrainingSeed
from minitouch_bench.leaderboard.twins import Sketch, sketch_of
from minitouch_bench.leaderboard.validation import Verdict
from minitouch_bench.metrics.summary import measure
from minitouch_bench.policies.formats import BUILT_IN
from minitouch_bench.policies.isolation.options import IsolationOptions
from minitouch_bench.policies.limits import limits_of
from minitouch_bench.policies.sources import DIRECTORY, PolicySource, parse_source
from minitouch_bench.records import EpisodeMetrics, EpisodeRecord, PolicyIdentity, Role, SavedRun
from minitouch_bench.verification.fresh import (
    FreshResult,
    compare_fresh,
    fresh_seed,
    significant_drops,
)
from minitouch_bench.verification.problems import Problem, Problems
from minitouch_bench.verification.recorded_run import open_run
from minitouch_bench.verification.verify import check_identity, draw_episodes, rerun, verify_run

NOT_REPLAYED = "the recorded actions do not give these figures"
NOT_REPEATED = "the checkpoint does not act as recorded"
FITS_OFFICIAL = "the checkpoint fits the official episodes"


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


def run_fresh(
    verdict: Verdict, count: int, draw: str, proving: Proving
) -> tuple[FreshProof, Problems]:
    """Run ``count`` new episodes of each task of the main suite, and compare with the official.

    A significant drop is a problem.
    """
    problems = Problems()
    seeds: dict[str, int] = {}
    results: dict[str, tuple[FreshResult, ...]] = {}
    assert verdict.submission is not None
    for seed in verdict.submission.seeds:
        place = seed.runs[MAIN_SUITE]
        with problems.caught(place):
            saved = verdict.runs[place]
            seeds[place] = fresh_seed(saved.header.policy.digest, draw)
            setup = _setup(verdict.directory, seed, saved)
            results[place] = _fresh_results(saved, setup, count, seeds[place], proving)
            for drop in significant_drops(results[place]):
                text = (
                    f"{drop.metric} {drop.official:.3f} officially, {drop.fresh:.3f} in "
                    f"{drop.episodes} fresh episodes (p = {drop.p:.2g})"
                )
                problems.add_below(place, Problem(f"{drop.role} {drop.task}", text, FITS_OFFICIAL))
    return FreshProof(draw, count, seeds, results), problems


def _fresh_results(
    saved: SavedRun, setup: PolicySetup, count: int, seed: int, proving: Proving
) -> tuple[FreshResult, ...]:
    suite = replace(
        find_suite(MAIN_SUITE), tasks=saved.header.tasks, episodes_per_task=count, seed=seed
    )
    measured: dict[tuple[Role, str], list[EpisodeMetrics]] = {}
    for record in proving.engine.run(setup, suite.episodes(exploration=bool(setup.exploration))):
        proving.on_record(record)
        measured.setdefault((record.spec.role, record.spec.task), []).append(measure(record))
    official = dict(saved.by_role())
    return tuple(
        compare_fresh([one for one in official[role] if one.task == task], own, role, task)
        for (role, task), own in measured.items()
    )


def sketch_runs(verdict: Verdict) -> dict[str, Sketch]:
    """Return the sketch of each main run's actions, by its path."""
    assert verdict.submission is not None
    found = {}
    for seed in verdict.submission.seeds:
        place = seed.runs[MAIN_SUITE]
        run, _ = open_run(verdict.directory / place)
        if run is not None:
            found[place] = sketch_of([run.actions[spec.key] for spec in run.specs])
    return found


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
    setup = _setup(directory, seed, run.saved)
    specs = draw_episodes(run, count, proving.rng)
    for record, differing in rerun(run, setup, specs, proving.engine):
        proving.on_record(record)
        for problem in differing:
            problems.add_below(place, replace(problem, remedy=NOT_REPEATED))


def _setup(directory: Path, seed: TrainingSeed, saved: SavedRun) -> PolicySetup:
    header = saved.header
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
        IncompleteCheckError: it is not there.
        UsageError: it is another one.
        PolicyLoadError: it cannot be read.
    """
    files = seed.files(role)
    if recorded.kind in BUILT_IN:
        return parse_source(recorded.kind)
    if not files or not all(file.path for file in files):
        raise IncompleteCheckError(
            f"the {role} checkpoint of seed {seed.seed} is not in the submission: "
            "it cannot be run again"
        )
    places = directory / CHECKPOINTS / f"seed-{seed.seed}" / role.value
    path = places if recorded.kind == DIRECTORY else directory / files[0].path
    source = parse_source(str(path))
    check_identity(recorded, source)
    return source
