"""Evaluate an arm of a grid for the leaderboard: the policies of a training seed in one run.

The policies of each finished training seed are copied to ``GRID/rows/ARM/seed-N``, and play the
official episodes of all tasks. The runs, ``GRID/rows/ARM/seed-N/table4``, are what
``minitouch-bench submit`` packs. The same command continues after an interruption, and when further
seeds are finished.
"""

import argparse
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import minitouch_bench as mt
from experiments.grid import Cell, cells_of, finished_cells, read_design


def collect(cells: Sequence[Cell], grid: Path, place: Path) -> tuple[Path, Path]:
    """Copy the policies of one training seed; return the folders of the final and exploration ones.

    In Playing the final policy is the exploration policy, so it is copied once.
    """
    final, exploration = place / "final", place / "exploration"
    for folder in (final, exploration):
        folder.mkdir(parents=True, exist_ok=True)
        for cell in cells:
            if folder == final or cell.task != "playing":
                trained = grid / cell.name / f"{folder.name}.safetensors"
                shutil.copyfile(trained, folder / f"{cell.task}.safetensors")
    return final, exploration


def evaluate_arm(design_file: Path, grid: Path, arm: str, workers: str) -> bool:
    """Evaluate the training seeds that are finished, and say whether these are all."""
    design = read_design(design_file)
    finished = finished_cells(grid)
    is_complete = True
    for seed in design["seeds"]:
        cells = [one for one in cells_of(design) if (one.method, one.training_seed) == (arm, seed)]
        if missing := [cell.name for cell in cells if cell not in finished]:
            print(f"seed {seed} waits for {', '.join(missing)}", file=sys.stderr)
            is_complete = False
            continue
        place = grid / "rows" / arm / f"seed-{seed}"
        final, exploration = collect(cells, grid, place)
        output = place / "table4"
        mt.evaluate(
            str(final), exploration=str(exploration), name=arm, output=output,
            workers=workers, resume=True,
        )  # fmt: skip
        print(output, flush=True)
    return is_complete


def main() -> None:
    """Evaluate an arm, and print the directory of each run."""
    parser = argparse.ArgumentParser(prog="python -m experiments.row", description=__doc__)
    parser.add_argument("design", type=Path)
    parser.add_argument("arm", help="with one length of exploration per task")
    parser.add_argument("grid", type=Path, help="the --output of the grid")
    parser.add_argument("--workers", default="auto", help="processes that play episodes")
    given = parser.parse_args()
    is_complete = evaluate_arm(given.design, given.grid, given.arm, given.workers)
    sys.exit(0 if is_complete else 1)


if __name__ == "__main__":
    main()
