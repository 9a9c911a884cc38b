"""A submission checked without trusting it: nothing of it is executed."""

import hashlib
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import TypeVar

from minitouch_bench.episode import Episode, PolicyIdentity, Role
from minitouch_bench.errors import IncompleteCheckError, MiniTouchError, UnreadableFileError
from minitouch_bench.files import ACTIONS_FILE, RUN_FILE, SUBMISSION_FILE, list_videos
from minitouch_bench.leaderboard.proof import Proof, ProofLevel, find_proof, level_of
from minitouch_bench.leaderboard.submission import (
    ALL_TASKS,
    MAX_SUBMISSION_FILE,
    RUN_LIMITS,
    SEE,
    CheckpointFile,
    Submission,
    TrainingSeed,
    check_checkpoints,
    check_content,
    check_files,
    list_files,
    read_plain,
    read_submission,
)
from minitouch_bench.policies import sources
from minitouch_bench.policies.formats import BUILT_IN, FORMATS
from minitouch_bench.policies.policy import DIRECTORY, NOTES, Isolation
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.runs.run import Run, parse_run
from minitouch_bench.verification import static_check
from minitouch_bench.verification.static_check import AS_WRITTEN, Findings, Problems

RESERVED_MODALITIES: Mapping[str, tuple[str, ...]] = {
    kind: ("state",) if kind == "scripted" else () for kind in BUILT_IN
}
"""What the calibration policies look at."""

KINDS = (*FORMATS, "scripted", DIRECTORY)

COPIED_SHARE = 0.5
"""Share of equal episodes that makes a run a copy of another: two trainings have none."""

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, kw_only=True)
class SubmissionFindings(Findings):
    """A submission and what its check found; ``runs`` by the path of their directory in it.

    ``submission`` is empty where it cannot be read. ``files``: the SHA-256 of each file that a
    proof is about, by its path; empty where one cannot be read. ``proof``: theirs, if there is one.
    ``withdrawn``: the level of an earlier proof that the problems ended. ``error``: why the check
    could not be finished.
    """

    directory: Path
    submission: Submission = field(default_factory=Submission)
    runs: Mapping[str, Run] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    proof: Proof | None = None
    withdrawn: ProofLevel | None = None
    error: MiniTouchError | None = None

    @property
    def passed(self) -> bool:
        """Whether everything was checked and is as it should be."""
        return not self.problems and self.error is None

    @property
    def name(self) -> str:
        """What the submission is called here: its directory's name."""
        return self.directory.name or str(self.directory)

    @property
    def is_other_protocol(self) -> bool:
        """Whether nothing is wrong but that it was made under another protocol."""
        return bool(self.problems) and all(problem.is_other_protocol for problem in self.problems)

    @property
    def level(self) -> ProofLevel:
        """How well the submission is proved."""
        return level_of(self.runs, self.proof)

    def runs_on(self, suite: str) -> tuple[Run, ...]:
        """Return the run of each training seed; none where one of them lacks the suite."""
        places = [seed.runs.get(suite, "") for seed in self.submission.seeds]
        return tuple(self.runs[folder] for folder in places) if all(places) else ()

    def episodes(self, task: str) -> list[list[Episode]]:
        """Return the final policy's episodes of a task of MAIN_SUITE, of each training seed."""
        runs = self.runs_on(MAIN_SUITE)
        return [[row for row in run.rows if row.task == task] for run in runs]

    def videos(self) -> tuple[str, ...]:
        """Return the paths of its videos inside the submission."""
        return tuple(
            video.relative_to(self.directory).as_posix()
            for folder in self.runs
            for video in list_videos(self.directory / folder)
        )


def validate(directory: Path, *, trust_proofs: bool = False) -> SubmissionFindings:
    """Check a submission's directory and collect every problem.

    All that follows from the episodes is computed again. With ``trust_proofs`` it is not where a
    maintainer's proof is about these very bytes: a leaderboard shows what was proved before.
    """
    problems = Problems()
    sizes = list_files(directory, problems)
    submission = None
    if SUBMISSION_FILE in sizes:
        with problems.caught(SUBMISSION_FILE, SEE):
            content = read_plain(directory, SUBMISSION_FILE, MAX_SUBMISSION_FILE)
            submission = read_submission(content, problems)
    elif {"", SUBMISSION_FILE}.isdisjoint(problem.place for problem in problems):
        remedy = "make one with minitouch-bench submit"
        problems.add(SUBMISSION_FILE, "it is missing: this is not a submission", remedy)
    if submission is None or not submission.seeds:  # for which there is a problem
        return SubmissionFindings(tuple(problems), directory=directory)
    videos = check_files(directory, submission, sizes, problems)
    runs: dict[str, Run] = {}
    for folder in (folder for seed in submission.seeds for folder in seed.runs.values()):
        path, actions = f"{folder}/{RUN_FILE}", f"{folder}/{ACTIONS_FILE}"
        if path in sizes and actions in sizes and sizes[actions] <= RUN_LIMITS[ACTIONS_FILE]:
            with problems.caught(path, AS_WRITTEN):
                run_json = read_plain(directory, path, RUN_LIMITS[RUN_FILE])
                runs[folder] = parse_run(run_json, folder, directory / folder)
    proved: dict[str, str] = {}
    with suppress(UnreadableFileError):
        contents = {SUBMISSION_FILE: content}
        for folder, one in runs.items():
            contents[f"{folder}/{RUN_FILE}"] = one.content
            contents[f"{folder}/{ACTIONS_FILE}"] = one.actions_content
        proved = {
            path: hashlib.sha256(data).hexdigest() for path, data in contents.items()
        } | videos
    proof = find_proof(directory, proved)
    recompute = not (trust_proofs and proof)
    for seed in submission.seeds:
        for suite, folder in seed.runs.items():
            if run := runs.get(folder):
                _check_run(run, suite, seed, folder, problems, recompute=recompute)
        check_checkpoints(directory, seed, sizes, problems)
    _check_about(submission, runs, directory, problems)
    for (first, folder), count in find_copies(runs).items():
        shared = f"{count} of its {len(runs[folder].rows)} episodes"
        problems.add(folder, f"{shared} are bit for bit those of {first}", "remove it")
    return SubmissionFindings(
        tuple(problems),
        directory=directory,
        submission=submission,
        runs=runs,
        files=proved,
        proof=proof,
    )


def fetch_references(found: SubmissionFindings) -> SubmissionFindings:
    """Fetch the checkpoints that are on the Hub, and compare their bytes with ``submission.toml``.

    Call it where nothing else is wrong. ``error`` of the result says what cannot be fetched.
    """
    problems, error = Problems(), None
    for file in (file for seed in found.submission.seeds for file in seed.checkpoints):
        if file.is_reference:
            try:
                path, _ = sources.fetch_hub_file(sources.parse_hub_address(file.path))
            except MiniTouchError as caught:
                error = IncompleteCheckError(str(caught))
                continue
            with problems.caught(file.path):
                check_content(file, sources.read_checkpoint(path), problems)
    return replace(found, problems=(*found.problems, *problems), error=found.error or error)


def _check_run(
    run: Run, suite: str, seed: TrainingSeed, path: str, problems: Problems, *, recompute: bool
) -> None:
    """Check a run by itself, and against what the submission says of it.

    Of a run of another suite, or that is not official, nothing more can be said. ``recompute``:
    see ``check_run``.
    """
    header = run.header
    if header.plan.suite != suite:
        what = f"it is a run of the suite '{header.plan.suite}', not {suite}"
        problems.add(path, what, static_check.RUN_AGAIN)
        return
    if not header.official:
        reasons = "; ".join(header.unofficial_because)
        problems.add(path, f"it is unofficial: {reasons}", f"evaluate the whole suite {suite}")
        return
    with problems.caught(path, AS_WRITTEN):
        found = static_check.check_run(run, recompute=recompute)
        problems.add_below(path, found)
        if any(problem.is_other_protocol for problem in found):
            return
    _check_policy(header.policy, seed.files(Role.FINAL), path, problems)
    if header.exploration is not None:
        _check_policy(header.exploration, seed.files(Role.EXPLORATION), path, problems)
        if header.exploration.kind == "scripted" != header.policy.kind:
            problems.add(path, "its exploration is the scripted policy's, which reads the state")
    if header.isolation == Isolation.NONE and header.policy.kind != "scripted":
        what = "the policy ran beside the simulator (isolation none), which it could read"
        problems.add(path, what, "evaluate with --isolation sandbox")


def _check_policy(
    policy: PolicyIdentity, files: Sequence[CheckpointFile], path: str, problems: Problems
) -> None:
    """Compare a policy with the checkpoint files that the submission names for it."""
    if policy.kind not in KINDS:
        problems.add(path, f"'{policy.kind}' is no kind of policy", AS_WRITTEN)
        return
    if policy.notes != NOTES.get(policy.kind, ()):
        problems.add(path, f"a {policy.kind} policy lacks its label, or has another's", AS_WRITTEN)
    if policy.kind == DIRECTORY:
        digest = sources.directory_digest((file.file, file.sha256) for file in files)
    elif len(files) == 1 and files[0].task == ALL_TASKS:
        digest = files[0].sha256
    else:
        digest = "several files" if files else ""
    if policy.digest != digest:
        what = f"the policy '{policy.name}' is not the checkpoints of submission.toml: "
        remedy = "name the files that were evaluated, with their SHA-256"
        problems.add(path, f"{what}their SHA-256 differ", remedy)


def _check_about(
    submission: Submission, runs: Mapping[str, Run], directory: Path, problems: Problems
) -> None:
    """Compare what the submission says of itself with its directory and its policies."""
    add = partial(problems.add, SUBMISSION_FILE)
    name, folder = submission.name, directory.resolve().name
    if name and name != folder:
        remedy = "name the directory after the submission"
        add(f"the name is '{name}', the directory '{folder}'", remedy)
    kinds = {run.header.policy.kind for run in runs.values()}
    built_in = sorted(kinds & set(BUILT_IN))
    for kind in built_in:
        if name != kind:
            add(f"the built-in policy {kind} is not '{name}'")
        sees = RESERVED_MODALITIES[kind]
        if submission.modalities != sees or len(submission.seeds) > 1:
            add(f"{kind} is one seed with the modalities {list(sees)}")
    if kinds and not built_in:
        if name in BUILT_IN:
            add(f"the name '{name}' is a built-in policy's", "choose another")
        if not submission.modalities or "state" in submission.modalities:
            what = "a policy sees vision, touch or both; only scripted reads the state"
            add(what, "set modalities")
    explored = {
        seed.seed: run.header.exploration is not None
        for seed in submission.seeds
        if (run := runs.get(seed.runs.get(MAIN_SUITE, "")))
    }
    without = [str(seed) for seed, is_there in explored.items() if not is_there]
    if 0 < len(without) < len(explored):
        counted = f"{len(without)} of {len(explored)} training seeds"
        remedy = "evaluate every training seed with --exploration, or none"
        add(f"{counted} have no exploration policy: {', '.join(without)}", remedy)


def find_copies(runs: Mapping[Key, Run]) -> dict[tuple[Key, Key], int]:
    """Return the pairs of runs, in their order, that share episodes, and how many they share.

    They share at least COPIED_SHARE of the final policy's episodes of the smaller one, bit for
    bit: a copy that acts a little otherwise in most of its episodes is not seen. Episodes without
    a step are equal in every run and do not count.
    """
    owners: dict[tuple[str, int, str], list[Key]] = {}
    played = {key: [row for row in run.rows if row.steps] for key, run in runs.items()}
    for key, rows in played.items():
        for episode in dict.fromkeys((row.task, row.index, row.digest) for row in rows):
            owners.setdefault(episode, []).append(key)
    shared = Counter(pair for keys in owners.values() for pair in combinations(keys, 2))
    return {
        (first, other): count
        for (first, other), count in shared.items()
        if count >= COPIED_SHARE * min(len(played[first]), len(played[other]))
    }
