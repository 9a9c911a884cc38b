"""Train and evaluate every cell of a grid; after an interruption the same command continues.

A cell is a task, a method, a training seed and a length of exploration. Its training and its runs
are in a directory of its name. When the last of them is finished, the cell's rows are added to the
CSV files of the experiment, from which ``experiments.analysis`` makes tables and figures.
"""

import argparse
import fcntl
import hashlib
import os
import shutil
import signal
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from fnmatch import fnmatch
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any

import pandas as pd

import minitouch_bench as mt
from experiments.reliance import reliance_rows

KEY = ["task", "method", "training_seed", "exploration_steps"]
"""The columns that name a cell, in every CSV file."""

FILES = ("episodes", "estimates", "curves", "trainings")
"""The CSV files of an experiment; a cell is finished once it is in the last one."""

SAME_IN_ALL = ("arms", "preset", "settings", "episodes", "explore_once")
"""What may not change between two starts, because unlike trainings would be mixed; nor may the
``task_steps`` of a task."""


@dataclass(frozen=True)
class Cell:
    """One training of a grid; its fields are ``KEY``.

    ``method``: a method, or the name of an arm of the design.
    """

    task: str
    method: str
    training_seed: int
    exploration_steps: int

    @property
    def name(self) -> str:
        """Its directory."""
        return f"{self.task}-{self.method}-{self.exploration_steps}-{self.training_seed}"


def read_design(file: Path) -> dict[str, Any]:
    """Read the TOML file that describes a grid (see README.md), and add its SHA-256: ``digest``."""
    content = file.read_bytes()
    return {**tomllib.loads(content.decode()), "digest": hashlib.sha256(content).hexdigest()}


def default_output(file: Path) -> Path:
    """Return where the rows of a design go: to a directory of its name, or of its folder's."""
    return Path("reports/studies") / (
        file.resolve().parent.name if file.stem == "design" else file.stem
    )


def check_lock(design: Mapping[str, Any], directory: Path) -> None:
    """Exit where a locked design is not the one that its finished trainings were made with."""
    file = directory / "trainings.csv"
    if design.get("locked") and file.exists():
        made_with = {*pd.read_csv(file)["design"]} - {design["digest"]}
        if made_with:
            sys.exit(f"the design was changed after it was locked: {file} names {made_with.pop()}")


def in_task(design: Mapping[str, Any], task: str) -> dict[str, Any]:
    """Return the design with what is different in one task."""
    return {**design, **design.get("per_task", {}).get(task, {})}


def cells_of(design: Mapping[str, Any]) -> list[Cell]:
    """Return the cells, seed by seed."""
    return [
        Cell(task, method, seed, steps)
        for seed in design["seeds"]
        for task in design["tasks"]
        for steps in in_task(design, task)["exploration_steps"]
        for method in in_task(design, task)["methods"]
    ]


def arm_of(design: Mapping[str, Any], cell: Cell) -> dict[str, Any]:
    """Return an arm: its method, and the senses that it lacks in both phases or in the last."""
    senses = {"without": [], "task_without": []}
    return {"method": cell.method, **senses, **design.get("arms", {}).get(cell.method, {})}


def evaluations_of(design: Mapping[str, Any], cell: Cell) -> dict[str, dict[str, Any]]:
    """Return the options of ``mt.evaluate`` for each run of a cell, by directory."""
    suites = {**in_task(design, cell.task), **arm_of(design, cell)}.get("suites", ["table4"])
    suites = sorted(suites, key=lambda suite: suite != "table4")  # the first run is the main one
    asked = {suite: {"suite": suite, "episodes": design.get("episodes")} for suite in suites}
    for one in design.get("conditions", []):
        if _is_asked(one, cell):
            changes = {key: one.get(key, []) for key in ("without", "perturb")}
            words = [f"{key}-{','.join(value)}" for key, value in changes.items() if value]
            name = "-".join([*words, str(one["episodes"])]).replace(":", "-to-")
            asked[name] = {**changes, "episodes": one["episodes"]}
    return asked


def _is_asked(one: Mapping[str, Any], cell: Cell) -> bool:
    """Tell whether a table of the design is about a cell; by default it is about all."""
    is_task = cell.task in one.get("tasks", [cell.task])
    return is_task and cell.method in one.get("methods", [cell.method])


def finish_cell(design: Mapping[str, Any], cell: Cell, output: Path) -> dict[str, pd.DataFrame]:
    """Train and evaluate what is missing of a cell; return its rows of each CSV file."""
    place = output / cell.name
    final, explored = place / "final.safetensors", place / "exploration.safetensors"
    arm = arm_of(design, cell)
    shared = output / f"{cell.task}-exploration-{cell.exploration_steps}-{cell.training_seed}"
    digest = design["digest"]
    if not design.get("locked"):  # a claim or a seed may have been added since it was begun
        digest = _recorded_design(place) or _recorded_design(shared) or digest
    if not final.exists():
        task_steps = (
            None if cell.task == "playing" else in_task(design, cell.task).get("task_steps")
        )
        asked = {
            "method": arm["method"], "seed": cell.training_seed, "without": arm["without"],
            "exploration_steps": cell.exploration_steps, "preset": design.get("preset", "default"),
            "settings": {**design.get("settings", {}), "design": digest}, "resume": True,
        }  # fmt: skip
        if design.get("explore_once"):
            _copy_exploration(cell, asked, shared, place)
        mt.train(
            cell.task, **asked, task_steps=task_steps, task_without=arm["task_without"],
            output=place,
        )  # fmt: skip
    runs = []
    is_rated = (
        cell.task != "playing" and not arm["task_without"]
    )  # the exploration is another arm's
    for name, options in evaluations_of(design, cell).items():
        rates_exploration = name == "table4" and is_rated and explored.exists()
        run = mt.evaluate(
            str(final), tasks=[cell.task], name=cell.name, workers=1, resume=True,
            exploration=str(explored) if rates_exploration else None,
            output=place / name, **options,
        )  # fmt: skip
        runs.append(run)
    rows = rows_of(runs, place)
    asked = design.get("reliance")
    if asked and _is_asked(asked, cell):
        for name, more in reliance_rows(final, runs[0], asked).items():
            rows[name] = pd.concat([rows[name], more])
    return {name: with_key(frame, cell) for name, frame in rows.items()}


def with_key(frame: pd.DataFrame, cell: Cell) -> pd.DataFrame:
    """Return a cell's rows with ``KEY`` in front."""
    return pd.concat([pd.DataFrame([asdict(cell)] * len(frame), frame.index), frame], axis=1)


def _copy_exploration(cell: Cell, asked: Mapping[str, Any], shared: Path, place: Path) -> None:
    """Begin a cell with the exploration that the arms of its training seed share.

    The first of them trains it; a training goes on from there with the same bits as one that was
    never interrupted.
    """
    with open(f"{shared}.lock", "w", encoding="utf-8") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # the other worker may be training it
        mt.train(cell.task, **asked, task_steps=0, output=shared)
        if not place.exists():
            copy = place.with_name(f"{place.name}.tmp")
            # Not the final policy: with it the cell would count as trained.
            left_out = shutil.ignore_patterns("final.safetensors")
            shutil.copytree(shared, copy, dirs_exist_ok=True, ignore=left_out)
            copy.rename(place)


def _recorded_design(place: Path) -> str:
    """Return the SHA-256 of the design that a training was begun with, "" where none is named."""
    file = place / "config.toml"
    return str(tomllib.loads(file.read_text()).get("design", "")) if file.exists() else ""


def rows_of(runs: list[mt.Run], place: Path) -> dict[str, pd.DataFrame]:
    """Return a cell's rows of each CSV file, without its key."""
    played = [task_rows(run, run.plan.tasks[0]) for run in runs]
    training = {**training_row(place), "run_digests": " ".join(run.digest for run in runs)}
    return {
        **{name: pd.concat([one[name] for one in played]) for name in ("episodes", "estimates")},
        "curves": read_progress(place),
        "trainings": pd.DataFrame([training]),
    }


def read_progress(place: Path) -> pd.DataFrame:
    """Read the curve of a training as it was written."""
    return pd.read_csv(place / "progress.csv", dtype=str, keep_default_na=False)


def training_row(place: Path) -> dict[str, str]:
    """Return what is kept of a training: its length, its policies, its design."""
    last = read_progress(place).iloc[-1]
    return {
        "control_steps": last["step"],
        "seconds": last["seconds"],
        "final_policy": _sha256(place / "final.safetensors"),
        "exploration_policy": _sha256(place / "exploration.safetensors"),
        "design": _recorded_design(place),
    }


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.exists() else ""


def task_rows(run: mt.Run, task: str) -> dict[str, pd.DataFrame]:
    """Return a run's rows of ``episodes`` and ``estimates`` in one task, without a cell's key."""
    both = {"final": run.episodes, "exploration": run.exploration_episodes}
    frame = pd.concat([rows.assign(role=role) for role, rows in both.items() if len(rows)])
    frame = frame[frame["task"] == task].assign(**_where(run)).drop(columns=["task", "digest"])
    first = ["suite", "conditions", "role", "index"]
    return {
        "episodes": frame[[*first, *frame.columns.drop(first)]],
        "estimates": pd.DataFrame(_estimates(run, task)),
    }


def _where(run: mt.Run) -> dict[str, str]:
    plan = run.plan
    return {"suite": plan.suite, "conditions": ", ".join(plan.conditions.in_words())}


def _estimates(run: mt.Run, task: str) -> Iterator[dict[str, Any]]:
    """Yield the estimates of a task, unchanged; also those of both splits and of their gap."""
    (result,) = (one for one in run.summary.tasks if one.task == task)
    named = [*result.estimates.items()]
    for gaps in (one.gaps for one in run.summary.generalization if one.task == task):
        for metric, gap in gaps.items():
            named += [
                (f"{metric}, held-out", gap.held_out),
                (f"{metric}, train", gap.train),
                (f"{metric}, held-out minus train", gap.difference),
            ]
    for metric, estimate in named:
        values = asdict(estimate)
        interval, episodes = values.pop("method"), values.pop("count")
        yield {
            **_where(run),
            "metric": metric,
            **values,
            "episodes": episodes,
            "interval": interval,
        }


def add_rows(output: Path, cell: Cell, rows: Mapping[str, pd.DataFrame]) -> None:
    """Add a cell's rows to the CSV files; rows that it has there already are replaced."""
    key = [str(value) for value in asdict(cell).values()]
    with open(output / "rows.lock", "w", encoding="utf-8") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # another grid may add the rows of other cells
        for name, frame in rows.items():
            file, parts = output / f"{name}.csv", [frame]
            if file.exists():
                before = pd.read_csv(file, keep_default_na=False, dtype=str)
                parts.insert(0, before[(before[KEY] != key).any(axis=1)])
            temporary = file.with_suffix(".tmp")
            pd.concat(parts).to_csv(temporary, index=False)
            temporary.replace(file)


def finished_cells(file: Path) -> set[Cell]:
    """Return the cells that have rows in a CSV file; a finished one is in ``trainings.csv``."""
    if not file.exists():
        return set()
    rows = pd.read_csv(file, usecols=KEY)[KEY].drop_duplicates()
    return {Cell(*row) for row in rows.itertuples(index=False)}


def check_complete(design: Mapping[str, Any], directory: Path) -> None:
    """Exit where the rows of a training of the design are missing in one of the files."""
    cells = {*cells_of(design)}
    files = [directory / f"{name}.csv" for name in FILES]
    for file in (one for one in files if one.exists() or one.stem == "trainings"):
        if missing := cells - finished_cells(file):
            sys.exit(f"{file} lacks {len(missing)} of {len(cells)} trainings")


def run_grid(
    design_file: Path, output: Path, workers: int = 1, only: Sequence[str] = ("*",)
) -> dict[Cell, str]:
    """Finish the cells that are left, of those whose names match; return why a cell failed."""
    design = read_design(design_file)
    output.mkdir(parents=True, exist_ok=True)
    check_lock(design, output)
    kept = output / "design.toml"
    if kept.exists():
        before = read_design(kept)
        changed = [key for key in SAME_IN_ALL if before.get(key) != design.get(key)]
        changed += [
            f"task_steps of {task}"
            for task in {*before["tasks"]} & {*design["tasks"]}
            if in_task(before, task).get("task_steps") != in_task(design, task).get("task_steps")
        ]
        if changed:
            sys.exit(f"{output} was started with another {changed[0]}: choose another --output")
    kept.write_bytes(design_file.read_bytes())
    cells = [cell for cell in cells_of(design) if any(fnmatch(cell.name, one) for one in only)]
    finished = finished_cells(output / "trainings.csv")
    left = [cell for cell in cells if cell not in finished]
    print(f"{len(cells) - len(left)} of {len(cells)} cells are finished", file=sys.stderr)
    failed = {}
    spawned = get_context("spawn")
    with ProcessPoolExecutor(workers, spawned, initializer=_end_with_parent) as pool:
        jobs = {pool.submit(finish_cell, design, cell, output): cell for cell in left}
        try:
            for job in as_completed(jobs):
                cell = jobs[job]
                try:
                    add_rows(output, cell, job.result())
                    print(cell.name, file=sys.stderr)
                except mt.MiniTouchError as error:
                    failed[cell] = str(error)
                    print(f"{cell.name} failed: {error}", file=sys.stderr)
        finally:
            pool.shutdown(cancel_futures=True)  # after a fault no row would be added any more
    return failed


def _end_with_parent() -> None:
    """End this worker as soon as the process that started it has ended, killed or not."""
    parent = parent_process()
    if parent is not None:
        Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


def main() -> None:
    """Run the grid of a design file."""
    parser = argparse.ArgumentParser(prog="python -m experiments.grid", description=__doc__)
    parser.add_argument("design", type=Path)
    parser.add_argument("--output", type=Path, help="default: reports/studies/NAME")
    parser.add_argument("--workers", type=int, default=1, help="cells at a time, a core each")
    parser.add_argument(
        "--only", nargs="+", default=["*"], help="cells, as in 'pushing-hac-[0-9]*'"
    )
    given = parser.parse_args()
    # At Ctrl-C the executor would first finish the cells it has handed out.
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))
    output = given.output or default_output(given.design)
    sys.exit(1 if run_grid(given.design, output, given.workers, given.only) else 0)


if __name__ == "__main__":
    main()
