"""A thousand submissions, quickly: episodes of a few made runs, mixed row by row."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from minitouch_bench.leaderboard.packing import add_seed
from minitouch_bench.leaderboard.submission import TrainingSeed, run_place
from minitouch_bench.metrics.digest import run_digest
from minitouch_bench.reporting import derived_files, from_document
from minitouch_bench.reporting.json_document import to_text
from tests.leaderboard.synthetic import ABOUT, make_submission

SKILLS = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 0.95)
MODALITIES = (("vision", "touch"), ("touch",), ("vision",))


def make_many(root: Path, number: int) -> None:
    """Write so many submissions; their estimates in run.json are those of one of the runs mixed.

    A board computes its own figures and reads none of these, nor the actions.
    """
    bases = [
        make_submission(root / "_bases", f"base-{place}", skill, kind="remote")
        for place, skill in enumerate(SKILLS)
    ]
    documents = [json.loads((base / "seed-0/table4/run.json").read_text()) for base in bases]
    rng = np.random.default_rng(11)
    for turn in range(number):
        worse = int(rng.integers(len(bases) - 1))
        share = rng.random()
        directory = root / f"method-{turn:04d}"
        place = directory / run_place(0, "table4")
        place.mkdir(parents=True)
        document = _mix(documents[worse], documents[worse + 1], rng.random(400) < share)
        (place / "run.json").write_text(to_text(document))
        for name, text in derived_files(from_document(document, "run"), place).items():
            (place / name).write_text(text)
        os.link(bases[worse] / "seed-0/table4/actions.npz", place / "actions.npz")
        about = replace(
            ABOUT,
            name=directory.name,
            method=f"Method {turn} of a synthetic thousand",
            modalities=MODALITIES[turn % 3],
            training_steps=int(10 ** rng.uniform(5, 8)),
        )
        add_seed(directory, None, about, TrainingSeed(0, {"table4": run_place(0, "table4")}))


def _mix(one: dict, other: dict, chosen: np.ndarray) -> dict:
    """Take each episode from one of two runs, and seal the result."""
    rows = [
        (b if take else a)
        for a, b, take in zip(one["episodes"], other["episodes"], chosen, strict=True)
    ]
    document = {**one, "episodes": rows}
    saved = from_document(document, "run")
    return {**document, "digest": run_digest(saved.header.protocol_digest, saved.episodes)}
