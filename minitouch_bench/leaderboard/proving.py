"""Prove one submission as a maintainer does, and write what was proved.

Its actions are replayed, and sampled and fresh episodes are run with its checkpoints. This can take
hours, so what is done of a proof is kept: after an interruption the same command continues.
"""

import hashlib
import secrets
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from minitouch_bench import errors, files
from minitouch_bench.episode import EpisodeSpec, PlayedEpisode, PolicyIdentity, Role
from minitouch_bench.evaluation.engine import SILENT, Callbacks, Engine
from minitouch_bench.evaluation.execution import package_versions
from minitouch_bench.evaluation.policy_setup import PolicySetup
from minitouch_bench.json_io import read_json, write_json
from minitouch_bench.leaderboard import proof
from minitouch_bench.leaderboard.proof import ProofLevel, Values
from minitouch_bench.leaderboard.submission import TrainingSeed
from minitouch_bench.leaderboard.validation import SubmissionFindings
from minitouch_bench.metrics.summary import measure
from minitouch_bench.policies.formats import BUILT_IN
from minitouch_bench.policies.policy import DIRECTORY, PolicySource
from minitouch_bench.policies.sources import directory_digest, parse_source
from minitouch_bench.runs.run import Run
from minitouch_bench.verification import replay_check
from minitouch_bench.verification.static_check import Problems

RERUN_EPISODES, FRESH_EPISODES = 20, 50
"""Drawn episodes of each policy of a run that are run again; fresh episodes per task of a run."""

TIME_LIMIT_S = 5 * 3600.0
"""How long a proof may take: a policy may use minutes in each episode."""


@dataclass(frozen=True)
class FreshRun:
    """What the fresh episodes of a run gave: by role and task what ranks; and the faults."""

    values: tuple[tuple[Role, str, Values], ...]
    faults: tuple[str, ...]


@dataclass
class DonePart:
    """What of a proof is done, by the places of the runs in which nothing differs.

    ``draw``: of its fresh episodes. What is done is kept in the user's cache, where no submission
    and no policy in the sandbox can write.
    """

    draw: str = field(default_factory=lambda: secrets.token_hex(16))
    replayed: list[str] = field(default_factory=list)
    reran: list[str] = field(default_factory=list)
    fresh: dict[str, FreshRun] = field(default_factory=dict)


def prove(
    found: SubmissionFindings,
    engine: Engine,
    callbacks: Callbacks = SILENT,
    *,
    rerun: int = RERUN_EPISODES,
    fresh: int = FRESH_EPISODES,
) -> SubmissionFindings:
    """Replay a submission that is valid, run it again, and write the proof if nothing differs.

    The policies of a server and Python classes are replayed only. An earlier proof of a higher
    level stays; where an episode differs, it is withdrawn. ``rerun``: so many drawn episodes of
    each policy of each run. ``fresh``: so many new ones per task of each run; fewer than
    MIN_FRESH_EPISODES give no level. Where the check cannot be finished, ``error`` of the result
    says why, and what was replayed is proved.

    Raises:
        InterruptedRunError: Ctrl-C.
    """
    about = write_json((found.files, package_versions(), (rerun, fresh)))
    kept = files.cache_directory() / "proofs" / f"{hashlib.sha256(about).hexdigest()}.json"
    done = DonePart()
    with suppress(OSError, errors.RunDirectoryError):
        done = read_json(files.read_file(kept), DonePart, str(kept))
    prover = Prover(found, engine, callbacks.episode, done=done, kept=kept)
    callbacks.phase("proof", prover.count_episodes(rerun, fresh))
    level, played = ProofLevel.SELF_REPORTED, None
    error: errors.MiniTouchError | None = None
    try:
        prover.replay()
        level = ProofLevel.REPLAYED
        if proof.can_be_run(found.runs) and not prover.problems:
            prover.run_again(rerun)
        if proof.can_be_run(found.runs) and not prover.problems:
            played = prover.run_fresh(fresh)
            level = ProofLevel.VERIFIED if fresh >= proof.MIN_FRESH_EPISODES else level
    except KeyboardInterrupt as caught:
        raise errors.InterruptedRunError("interrupted\nThe same command continues.") from caught
    except errors.MiniTouchError as caught:  # what differs counts all the same
        error = errors.IncompleteCheckError(str(caught))
    if error is None or prover.problems:
        with suppress(OSError):
            kept.unlink()
    found = replace(found, problems=tuple(prover.problems), error=error)
    path = proof.proof_path(found.directory)
    is_verified = level is ProofLevel.VERIFIED
    is_weaker = found.level is ProofLevel.VERIFIED and not is_verified
    try:
        if found.proof and not all(problem.is_unchecked for problem in found.problems):
            with files.os_errors_as(errors.RunDirectoryError, path, "removed"):
                path.unlink(missing_ok=True)
            return replace(found, proof=None, withdrawn=found.level)
        if not (found.problems or is_weaker or level is ProofLevel.SELF_REPORTED):
            made = proof.Proof(level, found.files, *((rerun, played) if is_verified else ()))
            files.write_file(path, write_json(made))
            return replace(found, proof=made)
    except errors.RunDirectoryError as caught:
        return replace(found, error=caught)
    return found


def fresh_specs(run: Run, count: int, seed: int) -> tuple[EpisodeSpec, ...]:
    """Return ``count`` episodes of each task of a run, with another seed.

    On novel shapes they are the first ``count`` of the suite: its shapes in its order, in new
    scenes.
    """
    plan = replace(run.plan, episodes=count, seed=seed, chosen=())
    return plan.specs(exploration=run.header.exploration is not None)


def _values(run: Run, records: Sequence[PlayedEpisode]) -> Iterator[tuple[Role, str, Values]]:
    """Yield by role and task what ranks: officially, and in fresh episodes."""
    official = dict(run.by_role())
    for role, task in dict.fromkeys((one.spec.role, one.spec.task) for one in records):
        known = [row for row in official[role] if row.task == task]
        rows = [measure(one) for one in records if (one.spec.role, one.spec.task) == (role, task)]
        yield role, task, Values.of(task, known, rows)


@dataclass
class Prover:
    """Plays the episodes that prove a submission; each difference is added to ``problems``.

    ``on_record`` takes each episode that was played; ``rng`` draws those that are run again. No
    more is played ``time_limit_s`` after the prover was made. What is ``done`` is not played, and
    more of it is written to the file ``kept``, if there is one.
    """

    found: SubmissionFindings
    engine: Engine
    on_record: Callable[[PlayedEpisode], None] = lambda _: None
    rng: np.random.Generator = field(default_factory=np.random.default_rng)
    time_limit_s: float = TIME_LIMIT_S
    problems: Problems = field(default_factory=Problems)
    done: DonePart = field(default_factory=DonePart)
    kept: Path | None = None

    def __post_init__(self) -> None:
        self._end = time.monotonic() + self.time_limit_s

    def count_episodes(self, rerun: int, fresh: int) -> int:
        """Return how many episodes are left to play."""
        count = sum(len(run.header.specs()) for _, _, run in self._runs(self.done.replayed))
        if proof.can_be_run(self.found.runs):
            left = self._runs(self.done.reran)
            count += sum(rerun * len(run.header.policies()) for _, _, run in left)
            left = self._runs(self.done.fresh)
            count += sum(len(fresh_specs(run, fresh, 0)) for _, _, run in left)
        return count

    def replay(self) -> None:
        """Replay the actions of every run. No checkpoint is opened."""
        for _, place, run in self._runs(self.done.replayed):
            with self.problems.caught(place):
                found = replay_check.replay_run(run, self.engine, self._take)
                remedy = "the recorded actions do not give these values"
                self.problems.add_below(place, found.problems, remedy)
            self.done.replayed.append(place)
            self._keep()

    def run_again(self, count: int) -> None:
        """Run ``count`` drawn episodes of each policy of each run, held in the sandbox.

        Raises:
            IncompleteCheckError: see ``replay_check.run_again``.
        """
        for seed, place, run in self._runs(self.done.reran):
            with self.problems.caught(place):
                setup = self._setup(seed, run)
                specs = replay_check.draw_episodes(run, count, self.rng)
                found = replay_check.run_again(run, setup, specs, self.engine, self._take)
                remedy = "the checkpoint does not act as recorded"
                self.problems.add_below(place, found.problems, remedy)
            self.done.reran.append(place)
            self._keep()

    def run_fresh(self, count: int) -> proof.FreshProof:
        """Run ``count`` new episodes of each task of each run, and compare with the official ones.

        A significant drop is a problem. An episode that ends by a policy fault is a failed one; to
        find a machine that is too slow, call ``run_again`` first.

        Raises:
            IncompleteCheckError: the time is up.
        """
        runs = {place: run for _, place, run in self._runs()}
        draw, seeds = self.done.draw, dict[str, int]()
        for place, run in runs.items():
            seeds[place] = proof.fresh_seed(run.header.policy.digest, draw)
        for seed, place, run in self._runs(self.done.fresh):
            with self.problems.caught(place):
                specs = fresh_specs(run, count, seeds[place])
                setup = self._setup(seed, run)
                records = [*replay_check.play_all(setup, specs, self.engine, self._take).values()]
                failed = (f"{place}, {one.spec.key}: {one.fault}" for one in records if one.fault)
                self.done.fresh[place] = FreshRun(tuple(_values(run, records)), tuple(failed))
            self._keep()
        compared = {} if self.problems else self._compare_fresh(runs)
        return proof.FreshProof(draw, count, seeds, compared)

    def _compare_fresh(self, runs: Mapping[str, Run]) -> dict[str, tuple[proof.FreshResult, ...]]:
        """Compare the fresh episodes of all runs with the official ones; add the drops.

        They are those that an honest submission would hardly have.
        """
        results: dict[str, tuple[proof.FreshResult, ...]] = {}
        groups: dict[proof.Group, list[Values]] = {}
        failed: list[str] = []
        for place, run in runs.items():
            played = self.done.fresh[place]
            failed += played.faults
            compared = (proof.compare_fresh(one, role, task) for role, task, one in played.values)
            results[place] = tuple(compared)
            for role, task, one in played.values:
                groups.setdefault((role, run.plan.suite, task), []).append(one)
        planned = sum(map(len, results.values()))
        drops = [
            (f"{place}, {drop.role} {drop.task}", str(drop))
            for place, of_run in results.items()
            for drop in proof.significant_drops(of_run, planned)
        ]
        if not drops and (p := proof.drop_together(groups)) is not None:
            what = f"fresh episodes are worse over the tasks and training seeds (p = {p:.2g})"
            drops.append(("", what))
        for where, what in drops:
            self.problems.add(where, what, "the checkpoint fits the official episodes")
        if drops and failed:
            what = f"{len(failed)} fresh episodes end by a policy fault; the first: {failed[0]}"
            self.problems.add("", what, "a fault is a failed episode, as in every run")
        return results

    def _runs(self, done: Collection[str] = ()) -> Iterator[tuple[TrainingSeed, str, Run]]:
        """Walk through the runs that are not done, each with its training seed and its place."""
        for seed in self.found.submission.seeds:
            for place in seed.runs.values():
                if place not in done:
                    yield seed, place, self.found.runs[place]

    def _keep(self) -> None:
        """Keep what is done, as long as nothing differs."""
        if self.kept is not None and not self.problems:
            files.write_file(self.kept, write_json(self.done))

    def _take(self, record: PlayedEpisode) -> None:
        """Pass an episode on.

        Raises:
            IncompleteCheckError: the time is up.
        """
        self.on_record(record)
        if time.monotonic() > self._end:
            what = f"the proof was not finished within {self.time_limit_s:g} s"
            raise errors.IncompleteCheckError(f"{what}; the same command continues")

    def _setup(self, seed: TrainingSeed, run: Run) -> PolicySetup:
        """Find a run's policies in the submission.

        Raises:
            IncompleteCheckError: a checkpoint is not there.
            PolicyLoadError: it cannot be read.
        """
        final = self._source(seed, Role.FINAL, run.header.policy)
        recorded = run.header.exploration
        explorer = recorded and self._source(seed, Role.EXPLORATION, recorded)
        return replay_check.prepare_rerun(run, final, explorer)

    def _source(self, seed: TrainingSeed, role: Role, recorded: PolicyIdentity) -> PolicySource:
        listed = seed.files(role)
        if recorded.kind in BUILT_IN:
            return parse_source(recorded.kind)
        if not listed or not all(file.path for file in listed):
            raise errors.IncompleteCheckError(
                f"the {role} checkpoint of seed {seed.seed} is not in the submission: "
                "it cannot be run again"
            )
        folder = self.found.directory
        places = (file.path if file.is_reference else str(folder / file.path) for file in listed)
        sources = dict(zip(listed, map(parse_source, places), strict=True))
        if recorded.kind != DIRECTORY:
            return sources[listed[0]]
        digest = directory_digest((file.file, one.digest) for file, one in sources.items())
        parts = tuple((file.task, one) for file, one in sources.items())
        return PolicySource(DIRECTORY, folder.name, str(folder), digest, parts)
