"""The rows of a study whose policies were played as rows of the leaderboard.

``python -m experiments.played STUDY TRAINING...`` adds finished trainings to ``curves.csv`` and
``trainings.csv`` of a study's folder. What their policies did is read from the leaderboard's
results, where each method of the study is a submission of the same name.
"""

import argparse
import sys
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

import minitouch_bench as mt
from experiments.grid import (
    KEY,
    Cell,
    add_rows,
    cells_of,
    read_design,
    read_progress,
    task_rows,
    training_row,
    with_key,
)
from minitouch_bench.agents.config import read_recorded_config
from minitouch_bench.files import RESULTS
from minitouch_bench.policies.sources import directory_digest

ROOT = Path(__file__).parents[1]
SUITES = ("table4", "novel-shapes")


def collect(training: Path, study: Path) -> None:
    """Add the curve and the policies of a finished training to the CSV files of a study."""
    config = read_recorded_config(training / "config.toml")
    cell = Cell(config.task, config.method, config.seed, config.exploration.steps)
    lacks_senses = config.exploration.without or config.task_phase.without
    if lacks_senses or cell not in cells_of(read_design(study / "design.toml")):
        sys.exit(f"{training} is no training of {study}/design.toml")
    row = training_row(training)
    if int(row["control_steps"]) != config.steps:
        sys.exit(f"{training} ended after {row['control_steps']} of {config.steps} control steps")
    rows = {"curves": read_progress(training), "trainings": pd.DataFrame([row])}
    add_rows(study, cell, {name: with_key(frame, cell) for name, frame in rows.items()})


def put_in_order(study: Path) -> None:
    """Sort the rows of a study as its design lists its trainings, in whatever order they ended."""
    places = {
        cell: place for place, cell in enumerate(cells_of(read_design(study / "design.toml")))
    }
    for name in ("curves", "trainings"):
        rows = pd.read_csv(study / f"{name}.csv", dtype=str, keep_default_na=False)
        keys = rows[KEY].astype({"training_seed": int, "exploration_steps": int})
        order = [places[Cell(*key)] for key in keys.itertuples(index=False)]
        rows.iloc[np.argsort(order, kind="stable")].to_csv(study / f"{name}.csv", index=False)


@lru_cache(maxsize=1)
def played_rows(study: Path, results: Path = ROOT / RESULTS) -> dict[str, pd.DataFrame]:
    """Return the rows of ``episodes`` and ``estimates`` of a study's trainings.

    Raises:
        SystemExit: nothing was played, or a row with other policies than those of the study.
    """
    rows: dict[str, list[pd.DataFrame]] = {"episodes": [], "estimates": []}
    trainings = pd.read_csv(study / "trainings.csv", keep_default_na=False)
    for (method, seed), of_seed in trainings.groupby(["method", "training_seed"], sort=False):
        policies = zip(of_seed["task"] + ".safetensors", of_seed["final_policy"], strict=True)
        digest = directory_digest(policies)
        places = [results / str(method) / f"seed-{seed}" / suite for suite in SUITES]
        for run in (mt.load_run(place) for place in places if place.is_dir()):
            if run.header.policy.digest != digest:
                sys.exit(f"{run.directory} was played with other policies than those of {study}")
            for row in of_seed.itertuples():
                cell = Cell(row.task, row.method, row.training_seed, row.exploration_steps)
                if cell.task in run.plan.tasks:
                    for name, frame in task_rows(run, cell.task).items():
                        rows[name].append(with_key(frame, cell))
    if not rows["episodes"]:
        sys.exit(f"no training of {study} has a row in {results}")
    return {name: pd.concat(frames) for name, frames in rows.items()}


def main() -> None:
    """Add finished trainings to a study."""
    parser = argparse.ArgumentParser(prog="python -m experiments.played", description=__doc__)
    parser.add_argument("study", type=Path)
    parser.add_argument("trainings", type=Path, nargs="+")
    given = parser.parse_args()
    for training in given.trainings:
        collect(training, given.study)
    put_in_order(given.study)


if __name__ == "__main__":
    main()
