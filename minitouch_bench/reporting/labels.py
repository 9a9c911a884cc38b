"""What a run is called in tables and plots, and what must be said beside its figures."""

import shlex
from collections import Counter
from collections.abc import Sequence

from minitouch_bench.records import RunHeader, SavedRun
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.paper import PAPER_TASKS


def run_names(runs: Sequence[SavedRun]) -> tuple[str, ...]:
    """Name each run by its policy; runs of one policy name get the run's name too."""
    policies = Counter(run.header.policy.name for run in runs)
    names = []
    for run in runs:
        policy = run.header.policy.name
        name = policy if policies[policy] == 1 else f"{policy} ({run.name})"
        names.append(printable(name))
    return tuple(names)


def run_labels(run: SavedRun) -> tuple[str, ...]:
    """Return what a reader must know of a run: notes on the policy, and why it is unofficial."""
    header = run.header
    labels = list(header.policy.notes)
    if header.exploration is not None:
        labels += [
            f"exploration policy: {note}"
            for note in header.exploration.notes
            if note not in header.policy.notes
        ]
    if not header.official:
        reasons = "; ".join(header.unofficial_because)
        labels.append(f"unofficial: {reasons}" if reasons else "unofficial")
    if run.faults:
        labels.append(f"{len(run.faults)} policy {'fault' if len(run.faults) == 1 else 'faults'}")
    return tuple(printable(label) for label in labels)


def task_title(task: str) -> str:
    """Return a task's name as a heading."""
    return printable(task).capitalize()


def tasks_in_order(runs: Sequence[SavedRun]) -> tuple[str, ...]:
    """Return the tasks that any of the runs has, in the paper's order, others after them."""
    present = {task.task: None for run in runs for task in run.summary.tasks if task.estimates}
    known = [task for task in PAPER_TASKS if task in present]
    return (*known, *(task for task in present if task not in PAPER_TASKS))


def reproduce_command(header: RunHeader) -> str:
    """Return the command line that repeats a run."""
    words = ["minitouch-bench", "evaluate", header.policy.source, "--suite", header.suite]
    if header.exploration is not None:
        words += ["--exploration", header.exploration.source]
    if not header.official:
        words += ["--tasks", ",".join(header.tasks)]
        words += ["--episodes", str(header.episodes), "--seed", str(header.seed)]
    if header.policy.kind == "factory":
        words.append("--trust")
    return shlex.join(printable(word) for word in words)
