"""Join the official runs of a grid for the leaderboard: all tasks of a training seed in one run.

A grid evaluates each task's policies in a run of its own; ``minitouch-bench submit`` packs runs of
all tasks. An episode's bits depend neither on the other tasks nor on where its checkpoint is, so
nothing is played again; a maintainer's proof plays the checkpoints again. The policies of each
finished training seed are copied to ``GRID/rows/ARM/seed-N``, and the facts of the joined run are
written to ``GRID/rows/ARM/seed-N/table4``.
"""

import argparse
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import minitouch_bench as mt
from experiments.grid import Cell, cells_of, finished_cells, read_design
from minitouch_bench.evaluation.execution import header_of
from minitouch_bench.evaluation.policy_setup import prepare_policies
from minitouch_bench.files import ACTIONS_FILE, RUN_FILE, write_file
from minitouch_bench.metrics.summary import Summary
from minitouch_bench.protocol.minitouch import MAIN_SUITE
from minitouch_bench.runs.actions import pack_arrays
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.runs.run import RunHeader, run_digest, run_json


def collect(cells: Sequence[Cell], grid: Path, place: Path) -> tuple[Path, Path]:
    """Copy the policies of one training seed; return the folders of the final and exploration ones.

    In Playing the final policy is the exploration policy, so it is copied once; ``sac`` has none.
    """
    final, exploration = place / "final", place / "exploration"
    for folder in (final, exploration):
        folder.mkdir(parents=True, exist_ok=True)
        for cell in cells:
            trained = grid / cell.name / f"{folder.name}.safetensors"
            if folder == final or (cell.task != "playing" and trained.exists()):
                shutil.copyfile(trained, folder / f"{cell.task}.safetensors")
    return final, exploration


def join_runs(header: RunHeader, runs: Mapping[str, mt.Run], directory: Path) -> None:
    """Join runs of one task each, by task, to the run of ``header``, and write its facts.

    Raises:
        SystemExit: they have other episodes, or were played with unequal packages.
    """
    parts = [runs[task] for task in header.plan.tasks]
    rows = tuple(row for run in parts for row in run.rows)
    explored = tuple(row for run in parts for row in run.exploration_rows)
    specs = {spec for run in parts for spec in run.header.specs()}
    if specs != {*header.specs()} or any(
        run.environment.packages != parts[0].environment.packages for run in parts
    ):
        sys.exit(f"the runs for {directory} are not those of one evaluation")
    environment = replace(
        parts[0].environment,
        started=min(run.environment.started for run in parts),
        wall_s=round(sum(run.environment.wall_s for run in parts), 3),
    )
    joined = mt.Run(
        digest=run_digest(header, rows, explored),
        header=header,
        environment=environment,
        summary=Summary(tuple(run.summary.tasks[0] for run in parts)),
        faults={key: fault for run in parts for key, fault in run.faults.items()},
        rows=rows,
        exploration_rows=explored,
        name=directory.name,
        directory=directory,
    )
    actions = {key: array for run in parts for key, array in run.actions.items()}
    in_order = {spec.key: actions[spec.key] for spec in header.specs() if spec.key in actions}
    write_file(directory / ACTIONS_FILE, pack_arrays(in_order))
    write_file(directory / RUN_FILE, run_json(joined))


def join_arm(design_file: Path, grid: Path, arm: str) -> bool:
    """Join the runs of the training seeds that are finished, and say whether these are all."""
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
        setup = prepare_policies(
            str(final),
            make_plan(MAIN_SUITE),
            exploration=str(exploration) if any(exploration.iterdir()) else None,
            name=arm,
        )
        runs = {cell.task: mt.load_run(grid / cell.name / MAIN_SUITE) for cell in cells}
        join_runs(header_of(setup), runs, place / MAIN_SUITE)
        print(place / MAIN_SUITE)
    return is_complete


def main() -> None:
    """Join the runs of an arm, and print the directory of each."""
    parser = argparse.ArgumentParser(prog="python -m experiments.row", description=__doc__)
    parser.add_argument("design", type=Path)
    parser.add_argument("arm", help="with one length of exploration per task")
    parser.add_argument("grid", type=Path, help="the --output of the grid")
    given = parser.parse_args()
    sys.exit(0 if join_arm(given.design, given.grid, given.arm) else 1)


if __name__ == "__main__":
    main()
