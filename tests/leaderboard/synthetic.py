"""Rows without a simulator: a submission, and results of official size as ``play`` keeps them."""

import gzip
import hashlib
from dataclasses import replace
from pathlib import Path

from minitouch_bench.episode import PolicyIdentity, Role
from minitouch_bench.files import PACKED_RUN_FILE, write_file
from minitouch_bench.json_io import write_toml
from minitouch_bench.leaderboard.fresh import drop_p
from minitouch_bench.leaderboard.play import ROW_FILE, Entry, FreshDraw, RowFacts, RowRun
from minitouch_bench.leaderboard.submission import Submission
from minitouch_bench.policies.formats import BUILT_IN
from minitouch_bench.policies.policy import NOTES
from minitouch_bench.policies.sources import ALL_TASKS, CheckpointFile, SubmittedTraining
from minitouch_bench.runs.run import run_json
from tests.reporting.synthetic import measured, played

CHECKPOINT = b"weights of a policy that nobody ever loads"
ABOUT = Submission(
    name="hac",
    method="HaC, retrained",
    learner="SAC",
    authors=("A. Researcher", "B. Researcher"),
    paper="https://example.org/paper",
    code="https://example.org/code",
    license="Apache-2.0",
    training_steps=2_000_000,
    modalities=("vision", "touch"),
    notes="Trained on the train shapes.",
    trainings=(SubmittedTraining(0),),
)
MORNING, NOON = "2026-01-01T08:00:00+00:00", "2026-01-01T12:00:00+00:00"
"""When a row was played."""


def write_result(entry: Entry, part: RowRun, skill: float, faults: int = 0) -> None:
    """Write a run of a row as ``play`` does."""
    kind = entry.name if entry.submission.is_built_in else "native"
    policies = {
        role: PolicyIdentity(
            entry.name, f"{role}.safetensors", kind, part.training.digest(role), NOTES.get(kind, ())
        )
        for role in ((*Role,) if part.explores else (Role.FINAL,))
    }
    run = measured(played(part.plan, policies, skill, part.training.seed, faults))
    path = entry.results / part.place / PACKED_RUN_FILE
    write_file(path, gzip.compress(run_json(run), mtime=0))


def make_submission(
    submissions: Path, name="hac", seeds=(0,), *, exploration=False, about=ABOUT,
    content=b"", explored=b"", file="hac.safetensors",
) -> Path:  # fmt: skip
    """Write a submission that passes every check.

    ``content`` and ``explored``: of its final and exploration checkpoints, in place of any bytes.
    """
    directory = submissions / name
    roles = () if name in BUILT_IN else (*Role,)[: 1 + (exploration or explored != b"")]
    trainings = []
    for seed in seeds:
        training = SubmittedTraining(seed)
        for role, given in zip(roles, (content, explored), strict=False):
            written = given or CHECKPOINT + f"{name} {role} {seed}".encode()
            one = CheckpointFile(role, ALL_TASKS, file, hashlib.sha256(written).hexdigest())
            write_file(directory / training.place(one), written)
            training = replace(training, checkpoints=(*training.checkpoints, one))
        trainings.append(training)
    told = replace(about, name=name, trainings=tuple(trainings))
    if name in BUILT_IN:
        sees = ("state",) if name == "scripted" else ()
        told = replace(told, modalities=sees, learner="", training_steps=0)
    write_file(directory / "submission.toml", write_toml(told))
    return directory


def make_row(
    root: Path, name="hac", skill=0.8, seeds=(0,), suites=("table4",), *, exploration=False,
    faults=0, about=ABOUT, at=MORNING, fresh_skill=None, content=b"",
) -> Entry:  # fmt: skip
    """Write a submission below ``root``, and what ``play`` keeps of it."""
    directory = make_submission(
        root / "submissions", name, seeds, exploration=exploration,
        about=replace(about, suites=suites), content=content,
    )  # fmt: skip
    entry = entry_of(directory)
    draws = tuple(
        FreshDraw(
            one.seed, one.digest(Role.FINAL), one.digest(Role.EXPLORATION), "ab" * 32, at, "Xeon"
        )
        for one in entry.submission.trainings
    )
    row = RowFacts(draws, played=suites)
    write_file(entry.results / ROW_FILE, write_toml(row))
    for part in entry.parts(row):
        own = fresh_skill if part.is_fresh and fresh_skill is not None else skill
        write_result(entry, part, own, 0 if part.is_fresh else faults)
    played_row = entry.read()
    row = replace(row, drop_p=drop_p(played_row.official, played_row.fresh))
    write_file(entry.results / ROW_FILE, write_toml(row))
    return entry


def entry_of(directory: Path) -> Entry:
    """Open a submission whose results lie beside the folder of all submissions."""
    return Entry.open(directory, directory.parent.parent / "results")
