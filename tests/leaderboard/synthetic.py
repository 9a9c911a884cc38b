"""Submissions of official size without a simulator: the facts of each run, as ``submit`` has."""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from minitouch_bench.episode import PolicyIdentity, Role
from minitouch_bench.files import write_file
from minitouch_bench.json_io import write_json, write_toml
from minitouch_bench.leaderboard.proof import FreshProof, FreshResult, Proof, ProofLevel, proof_path
from minitouch_bench.leaderboard.submission import (
    ALL_TASKS,
    CheckpointFile,
    Submission,
    TrainingSeed,
)
from minitouch_bench.leaderboard.validation import SubmissionFindings, validate
from minitouch_bench.runs.actions import write_actions
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.runs.run import Run, RunEnvironment, make_header, run_json
from tests.reporting.synthetic import Played, make_record, measured, with_fault

CHECKPOINT = b"weights of a policy that nobody ever loads"
ABOUT = Submission(
    name="hac",
    method="HaC, retrained",
    authors=("A. Researcher", "B. Researcher"),
    paper="https://example.org/paper",
    code="https://example.org/code",
    license="Apache-2.0",
    training_steps=2_000_000,
    modalities=("vision", "touch"),
    notes="Trained on the train shapes.",
)

FRESH_RESULT = FreshResult(Role.FINAL, "pushing", "success", 0.9, 0.88, 50, 0.4)
VIDEO = b"\0\0\0\x18ftypisom" + bytes(100)
"""The first bytes of an MP4 file."""


def official_run(
    suite="table4", skill=0.8, seed=0, *, exploration=False, faults=0, kind="native", **policy_facts
) -> Played:
    """Make a run of every episode of a suite, its policy as good as ``skill`` says."""
    rng = np.random.default_rng([seed, len(suite), int(1000 * skill)])
    records = []
    for spec in make_plan(suite).specs(exploration=exploration):
        ease = skill / 2 if spec.role is Role.EXPLORATION else skill
        record = make_record(rng, spec, ease * (0.9 if spec.split == "held-out" else 1.0))
        # The recorded actions are as applied; none of these stands at a bound.
        trace = replace(record.trace, clipped=np.zeros(len(record.trace.actions), bool))
        record = replace(record, trace=trace)
        if spec.task == "pushing" and spec.index < faults and spec.role is Role.FINAL:
            record = with_fault(record, "the action contains NaN or infinity", steps=spec.index)
            record = replace(
                record, trace=replace(record.trace, clipped=np.zeros(spec.index, bool))
            )
        records.append(record)
    digest = hashlib.sha256(CHECKPOINT).hexdigest() if kind == "native" else ""
    policy = PolicyIdentity("hac", "hac.safetensors", kind, digest)
    if kind in ("random", "zero", "scripted"):
        notes = ("reads the simulator's state",) if kind == "scripted" else ()
        policy = PolicyIdentity(kind, kind, kind, "", notes)
    if kind == "remote":
        policy = PolicyIdentity("host", "http://host:1", kind, "", ("remote",))
    policy = replace(policy, **policy_facts)
    isolation = {"scripted": "none", "remote": "process"}.get(kind, "sandbox")
    header = make_header(make_plan(suite), policy, policy if exploration else None, isolation)
    environment = RunEnvironment(
        packages={"minitouch-bench": "0.1.0", "pybullet": "3.2.7"},
        machine={"system": "Linux", "processor": "x86_64"},
        workers=2,
        started="2025-03-04T10:20:30+00:00",
        wall_s=754.2,
    )
    return Played(header, environment, tuple(records))


def write_official(run: Played, place: Path) -> None:
    """Write a run's facts as ``submit`` does."""
    place.mkdir(parents=True)
    write_actions(run.records, place)
    (place / "run.json").write_bytes(run_json(measured(run, place.name)))


def make_submission(
    root: Path, name="hac", skill=0.8, seeds=(0,), suites=("table4",), *, kind="native",
    exploration=False, faults=0, include=True, about=ABOUT, level=ProofLevel.VERIFIED,
) -> Path:  # fmt: skip
    """Write a submission that passes every check, with its proof; return its directory."""
    directory = root / name
    built_in = kind in ("random", "zero", "scripted")
    modalities = {"scripted": ("state",)}.get(kind, ()) if built_in else about.modalities
    entries = []
    for seed in seeds:
        for suite in suites:
            explored = exploration and suite == "table4"
            run = official_run(suite, skill, seed, exploration=explored, faults=faults, kind=kind)
            write_official(run, directory / f"seed-{seed}" / suite)
        files = _files(directory, seed, exploration, include) if kind == "native" else ()
        entries.append(TrainingSeed(seed, {s: f"seed-{seed}/{s}" for s in suites}, files))
    told = replace(about, name=name, modalities=modalities, seeds=tuple(entries))
    (directory / "submission.toml").write_text(write_toml(told))
    if level is not ProofLevel.SELF_REPORTED:
        prove_as(directory, level)
    return directory


def prove_as(directory: Path, level: ProofLevel = ProofLevel.VERIFIED) -> None:
    """Write a submission's proof as if a maintainer had played its episodes."""
    found = validate(directory)
    places = dict.fromkeys(found.runs)
    results = dict.fromkeys(places, (FRESH_RESULT,))
    fresh = FreshProof("a phrase", 50, dict.fromkeys(places, 1234), results)
    played = (20, fresh) if level is ProofLevel.VERIFIED else ()
    write_file(proof_path(directory), write_json(Proof(level, found.files, *played)))


def checkpoint_of(directory: Path, seed: int, role: Role, task: str, name: str) -> CheckpointFile:
    """Return what ``submission.toml`` says of a checkpoint that is in its place."""
    place = f"checkpoints/seed-{seed}/{role}/{name}"
    digest = hashlib.sha256((directory / place).read_bytes()).hexdigest()
    return CheckpointFile(role, task, name, digest, place)


def findings_of(directory: Path, run: Run, *checkpoints: CheckpointFile) -> SubmissionFindings:
    """Return what is found of a submission with this run: only its episodes are looked at."""
    place = "seed-0/table4"
    seed = TrainingSeed(0, {"table4": place}, checkpoints)
    submission = Submission(name=directory.name, seeds=(seed,))
    files = {"run.json": "0" * 64}
    return SubmissionFindings(
        directory=directory, submission=submission, runs={place: run}, files=files
    )


def _files(directory: Path, seed: int, exploration: bool, include: bool):
    digest = hashlib.sha256(CHECKPOINT).hexdigest()
    files = []
    for role in (Role.FINAL, *([Role.EXPLORATION] if exploration else [])):
        place = f"checkpoints/seed-{seed}/{role}/hac.safetensors" if include else ""
        files.append(CheckpointFile(role, ALL_TASKS, "hac.safetensors", digest, place))
        if include:
            (directory / place).parent.mkdir(parents=True)
            (directory / place).write_bytes(CHECKPOINT)
    return tuple(files)
