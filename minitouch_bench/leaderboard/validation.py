"""A submission checked without trusting it: nothing of it is executed."""

import hashlib
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path, PurePosixPath
from typing import TypeVar

from minitouch_bench.episode import Episode
from minitouch_bench.errors import MiniTouchError, UnreadableFileError
from minitouch_bench.files import (
    LARGEST_CHECKPOINT,
    RUN_FILE,
    SUBMISSION_FILE,
    list_videos,
    os_errors_as,
)
from minitouch_bench.leaderboard.proof import Proof, ProofLevel, find_proof, level_of
from minitouch_bench.leaderboard.submission import (
    ALL_TASKS,
    CheckpointFile,
    Submission,
    TrainingSeed,
    read_submission,
)
from minitouch_bench.leaderboard.submission_checks import (
    MAX_SUBMISSION_FILE,
    RUN_LIMITS,
    check_files,
    check_submitted,
    check_videos,
    list_files,
    read_plain,
)
from minitouch_bench.policies.policy import BUILT_IN, FORMATS, KIND_BY_SUFFIX
from minitouch_bench.policies.sources import check_zip
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.runs.run import Run, RunHeader, parse_run
from minitouch_bench.verification.problems import Findings, Problems
from minitouch_bench.verification.static_check import AS_WRITTEN

RESERVED_MODALITIES: Mapping[str, tuple[str, ...]] = {
    kind: ("state",) if kind == "scripted" else () for kind in BUILT_IN
}
"""What the calibration policies look at."""

Key = TypeVar("Key", bound=Hashable)

COPIED_SHARE = 0.5
"""Share of equal episodes that makes a run a copy of another: two trainings have none."""


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
    with problems.caught(""), os_errors_as(UnreadableFileError, directory, "read"):
        if not directory.is_dir():
            problems.add("", "it is not a directory", "give a submission's directory")
    if problems:
        return SubmissionFindings(tuple(problems), directory=directory)
    files = list_files(directory, problems)
    content = _read_content(directory, files, problems)
    submission = None if content is None else read_submission(content, problems)
    if content is None or submission is None:
        return SubmissionFindings(tuple(problems), directory=directory)
    check_files(submission, files, problems)
    folders = [folder for seed in submission.seeds for folder in seed.runs.values()]
    read = {folder: _read_run(directory, folder, files, problems) for folder in folders}
    runs = {folder: run for folder, run in read.items() if run is not None}
    proved: dict[str, str] = {}
    with suppress(UnreadableFileError):
        proved = _file_digests(content, runs) | check_videos(directory, files, folders, problems)
    proof = find_proof(directory, proved)
    recompute = not (trust_proofs and proof)
    for seed in submission.seeds:
        for suite, folder in seed.runs.items():
            if run := runs.get(folder):
                check_submitted(run, suite, seed, folder, problems, recompute=recompute)
        _check_checkpoints(directory, seed, files, problems)
    _check_about(submission, [run.header for run in runs.values()], directory, problems)
    _check_exploration(submission, runs, problems)
    check_copies(runs, problems)
    return SubmissionFindings(
        tuple(problems),
        directory=directory,
        submission=submission,
        runs=runs,
        files=proved,
        proof=proof,
    )


def _file_digests(content: bytes, runs: Mapping[str, Run]) -> dict[str, str]:
    """Return the SHA-256 of ``submission.toml`` and of each run's files, by path.

    Raises:
        UnreadableFileError: one of them cannot be read.
    """
    return {SUBMISSION_FILE: hashlib.sha256(content).hexdigest()} | {
        f"{folder}/{name}": digest
        for folder, run in runs.items()
        for name, digest in run.file_digests().items()
    }


def _check_exploration(submission: Submission, runs: Mapping[str, Run], problems: Problems) -> None:
    """Check that the main runs of all training seeds have an exploration policy, or of none."""
    explored = {
        seed.seed: run.header.exploration is not None
        for seed in submission.seeds
        if (run := runs.get(seed.runs.get(MAIN_SUITE, "")))
    }
    without = [str(seed) for seed, is_there in explored.items() if not is_there]
    if 0 < len(without) < len(explored):
        problems.add(
            SUBMISSION_FILE,
            f"{len(without)} of {len(explored)} training seeds have no exploration policy: "
            f"{', '.join(without)}",
            "evaluate every training seed with --exploration, or none",
        )


def _read_content(directory: Path, files: Mapping[str, int], problems: Problems) -> bytes | None:
    """Return the bytes of ``submission.toml``, None where it cannot be read."""
    if SUBMISSION_FILE not in files:
        problems.add(
            SUBMISSION_FILE,
            "it is missing: this is no submission",
            "make one with minitouch-bench submit",
        )
        return None
    content = None
    with problems.caught(SUBMISSION_FILE):
        content = read_plain(directory, SUBMISSION_FILE, MAX_SUBMISSION_FILE)
    return content  # noqa: RET504 - mypy does not see that the block catches errors


def _read_run(
    directory: Path, folder: str, files: Mapping[str, int], problems: Problems
) -> Run | None:
    path = f"{folder}/{RUN_FILE}"
    if path not in files:
        return None
    run = None
    with problems.caught(path, AS_WRITTEN):
        content = read_plain(directory, path, RUN_LIMITS[RUN_FILE])
        run = parse_run(content, folder, directory / folder)
    return run  # noqa: RET504 - mypy does not see that the block catches errors


def _check_about(
    submission: Submission, headers: Sequence[RunHeader], directory: Path, problems: Problems
) -> None:
    """Hold what the submission tells against its directory and its policies."""
    if submission.name and submission.name != directory.resolve().name:
        problems.add(
            SUBMISSION_FILE,
            f"the name is '{submission.name}', the directory '{directory.resolve().name}'",
            "name the directory after the submission",
        )
    kinds = {header.policy.kind for header in headers}
    for kind in sorted(kinds & set(BUILT_IN)):
        if submission.name != kind:
            problems.add(SUBMISSION_FILE, f"the built-in policy {kind} is not '{submission.name}'")
        if submission.modalities != RESERVED_MODALITIES[kind] or len(submission.seeds) > 1:
            problems.add(
                SUBMISSION_FILE,
                f"{kind} is one seed with the modalities {list(RESERVED_MODALITIES[kind])}",
            )
    if kinds and not kinds & set(BUILT_IN):
        if submission.name in BUILT_IN:
            what = f"the name '{submission.name}' is a built-in policy's"
            problems.add(SUBMISSION_FILE, what, "choose another")
        if not submission.modalities or "state" in submission.modalities:
            problems.add(
                SUBMISSION_FILE,
                "a policy sees vision, touch or both; only scripted reads the state",
                "set modalities",
            )


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


def check_copies(runs: Mapping[str, Run], problems: Problems) -> None:
    """Refuse each run that has, bit for bit, the episodes of an earlier one."""
    for (first, folder), count in find_copies(runs).items():
        number = len(runs[folder].rows)
        what = f"{count} of its {number} episodes are bit for bit those of {first}"
        problems.add(folder, what, "remove it")


def _check_checkpoints(
    directory: Path, seed: TrainingSeed, files: dict[str, int], problems: Problems
) -> None:
    """Check the names of a training seed's files, and the bytes of those that are there."""
    for file in seed.checkpoints:
        _check_file_name(file, problems)
        if not file.path or file.path not in files:
            continue
        with problems.caught(file.path):
            content = read_plain(directory, file.path, LARGEST_CHECKPOINT)
            if hashlib.sha256(content).hexdigest() != file.sha256:
                problems.add(
                    file.path,
                    "its SHA-256 is not that of submission.toml",
                    "put the file that was evaluated there",
                )
            name = PurePosixPath(file.path)
            if name.suffix in KIND_BY_SUFFIX and FORMATS[KIND_BY_SUFFIX[name.suffix]].is_zip:
                check_zip(content, name.name)


def _check_file_name(file: CheckpointFile, problems: Problems) -> None:
    name = PurePosixPath(file.file)
    if file.file and name.suffix not in KIND_BY_SUFFIX:
        problems.add(
            file.file,
            "it is no checkpoint",
            f"a checkpoint ends in {', '.join(KIND_BY_SUFFIX)}",
        )
    if file.task not in (ALL_TASKS, name.stem):
        problems.add(file.file, f"it is not named after its task {file.task}", "rename it")
