"""Submissions of official size without a simulator: each run as ``evaluate`` writes it."""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from minitouch_bench.evaluation.actions import write_actions
from minitouch_bench.evaluation.suites import SUITES
from minitouch_bench.leaderboard.packing import add_seed, begun_submission, tidy
from minitouch_bench.leaderboard.proof import (
    PROVED_LEVELS,
    ProofLevel,
    make_proof,
    proof_path,
    write_proof,
)
from minitouch_bench.leaderboard.submission import (
    ALL_TASKS,
    CheckpointFile,
    Submission,
    TrainingSeed,
    checkpoint_place,
    run_place,
)
from minitouch_bench.leaderboard.validation import validate
from minitouch_bench.metrics.summary import summarize
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import EvaluationRun, PolicyIdentity, Role, RunEnvironment, RunHeader
from minitouch_bench.reporting.run_directory import write_run
from tests.reporting.synthetic import make_record, with_fault

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


def official_run(
    suite="table4", skill=0.8, seed=0, *, exploration=False, faults=0, kind="native"
) -> EvaluationRun:
    """Make a run of every episode of a suite, its policy as good as ``skill`` says."""
    rng = np.random.default_rng([seed, len(suite), int(1000 * skill)])
    records = []
    for spec in SUITES[suite].episodes(exploration=exploration):
        ease = skill / 2 if spec.role is Role.EXPLORATION else skill
        record = make_record(rng, spec, ease * (0.9 if spec.split == "held-out" else 1.0))
        # The recorded actions are as applied; none of these stands at a bound.
        trace = replace(record.trace, clipped=np.zeros(len(record.trace.actions), bool))
        record = replace(record, trace=trace)
        if spec.task == "pushing" and spec.index < faults and spec.role is Role.FINAL:
            record = with_fault(record, "the action holds NaN or infinity", steps=spec.index)
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
    header = RunHeader(
        protocol=PROTOCOL.name,
        protocol_digest=PROTOCOL.digest(),
        task_digests={task: PROTOCOL.task_digest(task, suite) for task in SUITES[suite].tasks},
        suite=suite,
        official=True,
        unofficial_because=(),
        tasks=SUITES[suite].tasks,
        episodes=SUITES[suite].episodes_per_task,
        seed=0,
        policy=policy,
        exploration=policy if exploration else None,
        act_timeout_s=5.0,
        isolation="none" if kind == "scripted" else "sandbox",
    )
    environment = RunEnvironment(
        packages={"minitouch-bench": "0.1.0", "pybullet": "3.2.7"},
        machine={"system": "Linux", "processor": "x86_64"},
        workers=2,
        started="2025-03-04T10:20:30+00:00",
        wall_s=754.2,
    )
    return EvaluationRun(header, environment, tuple(records))


def write_official(run: EvaluationRun, place: Path) -> None:
    """Write a run's files as ``submit`` does."""
    place.mkdir(parents=True)
    write_actions(run.records, place)
    write_run(run, summarize(run, np.random.default_rng(0)), place)
    tidy(place)


def make_submission(
    root: Path,
    name="hac",
    skill=0.8,
    seeds=(0,),
    suites=("table4",),
    *,
    kind="native",
    exploration=False,
    faults=0,
    include=True,
    about=ABOUT,
    level=ProofLevel.RERUN,
) -> Path:
    """Write a submission that passes every check, with its proof; return its directory."""
    directory = root / name
    built_in = kind in ("random", "zero", "scripted")
    modalities = {"scripted": ("state",)}.get(kind, ()) if built_in else about.modalities
    for seed in seeds:
        for suite in suites:
            run = official_run(
                suite,
                skill,
                seed,
                exploration=exploration and suite == "table4",
                faults=faults,
                kind=kind,
            )
            write_official(run, directory / run_place(seed, suite))
        files = _files(directory, seed, exploration, include) if kind == "native" else ()
        entry = TrainingSeed(seed, {s: run_place(seed, s) for s in suites}, files)
        told = replace(about, name=name, modalities=modalities)
        add_seed(directory, begun_submission(directory), told, entry)
    if level in PROVED_LEVELS:
        write_proof(make_proof(validate(directory), level, 5), proof_path(directory))
    return directory


def _files(directory: Path, seed: int, exploration: bool, include: bool):
    digest = hashlib.sha256(CHECKPOINT).hexdigest()
    files = []
    for role in (Role.FINAL, *([Role.EXPLORATION] if exploration else [])):
        place = checkpoint_place(seed, role, "hac.safetensors") if include else ""
        files.append(CheckpointFile(role, ALL_TASKS, "hac.safetensors", digest, place))
        if include:
            (directory / place).parent.mkdir(parents=True)
            (directory / place).write_bytes(CHECKPOINT)
    return tuple(files)
