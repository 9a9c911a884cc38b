"""A thousand submissions, quickly: episodes of a few made runs, mixed row by row."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from minitouch_bench.leaderboard.packing import add_seed, begun_submission
from minitouch_bench.leaderboard.proof import ProofLevel, make_proof, proof_path, write_proof
from minitouch_bench.leaderboard.submission import TrainingSeed, run_place
from minitouch_bench.leaderboard.validation import Verdict
from minitouch_bench.records import SavedRun
from minitouch_bench.reporting.run_directory import derived_files, read_run, run_digest, run_json
from tests.leaderboard.synthetic import ABOUT, make_submission

SKILLS = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 0.95)
MODALITIES = (("vision", "touch"), ("touch",), ("vision",))


def make_many(root: Path, number: int) -> None:
    """Write so many submissions; their estimates in run.json are those of one of the runs mixed.

    A board computes its own figures and reads none of these, nor the actions.
    """
    bases = [
        make_submission(root / "_bases", f"base-{place}", skill, include=False)
        for place, skill in enumerate(SKILLS)
    ]
    runs = [read_run(base / "seed-0/table4") for base in bases]
    files = begun_submission(bases[0]).seeds[0].checkpoints
    rng = np.random.default_rng(11)
    for turn in range(number):
        worse = int(rng.integers(len(bases) - 1))
        share = rng.random()
        directory = root / f"method-{turn:04d}"
        place = directory / run_place(0, "table4")
        place.mkdir(parents=True)
        mixed = _mix(runs[worse], runs[worse + 1], rng.random(400) < share)
        (place / "run.json").write_bytes(run_json(mixed))
        for name, text in derived_files(mixed, place).items():
            (place / name).write_text(text)
        os.link(bases[worse] / "seed-0/table4/actions.npz", place / "actions.npz")
        about = replace(
            ABOUT,
            name=directory.name,
            method=f"Method {turn} of a synthetic thousand",
            modalities=MODALITIES[turn % 3],
            training_steps=int(10 ** rng.uniform(5, 8)),
        )
        add_seed(directory, None, about, TrainingSeed(0, {"table4": run_place(0, "table4")}, files))
        verdict = Verdict(directory, about, {run_place(0, "table4"): mixed}, ())
        write_proof(make_proof(verdict, ProofLevel.RERUN, 5), proof_path(directory))


def _mix(one: SavedRun, other: SavedRun, chosen: np.ndarray) -> SavedRun:
    """Take each episode from one of two runs, and seal the result."""
    episodes = tuple(
        (b if take else a) for a, b, take in zip(one.episodes, other.episodes, chosen, strict=True)
    )
    return replace(one, episodes=episodes, digest=run_digest(one.header, episodes))
