"""``forces.csv``: what the fingers of a run felt, a view beside its facts that reports draw.

``run.json`` has no forces. They are kept here while the episodes are played, or replayed.
"""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import PlayedEpisode, Role
from minitouch_bench.files import FORCES_FILE, read_file, write_file
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.runs.run import Run

COLUMNS = ("run", "task", "step", "episodes", "lower_quartile", "median", "upper_quartile")
"""``run``: the beginning of the run's digest; the last three in N."""


@dataclass(frozen=True)
class ForceStep:
    """The force at the end of a control step, N, over the ``episodes`` that reached the step.

    The force of an episode is the larger of its two fingers' forces.
    """

    episodes: int
    lower_quartile: float
    median: float
    upper_quartile: float


ForceCurves = Mapping[str, Sequence[ForceStep]]
"""A step per control step, by task."""


def force_curves(records: Sequence[PlayedEpisode]) -> ForceCurves:
    """Measure the forces of the final policy's episodes."""
    final = [record for record in records if record.spec.role is Role.FINAL]
    return {
        task: _curve([record for record in final if record.spec.task == task])
        for task in sorted({record.spec.task for record in final})
    }


def _curve(records: Sequence[PlayedEpisode]) -> list[ForceStep]:
    forces = [_larger_force(record) for record in records]
    steps = []
    for step in range(max(map(len, forces))):
        reached = [one[step] for one in forces if len(one) > step]
        quartiles = np.percentile(reached, (25, 50, 75)).round(3).tolist()
        steps.append(ForceStep(len(reached), *quartiles))
    return steps


def _larger_force(record: PlayedEpisode) -> NDArray[np.float32]:
    """Return the larger of both fingers' forces after each control step, N (T,)."""
    forces = record.trace.touch[1:, PROTOCOL.observation.forces]
    larger: NDArray[np.float32] = np.linalg.norm(forces.reshape(-1, 2, 3), axis=2).max(axis=1)
    return larger


def write_forces(run: Run, records: Sequence[PlayedEpisode], directory: Path) -> None:
    """Write ``forces.csv`` of a run whose episodes are ``records``.

    Raises:
        RunDirectoryError: the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for task, steps in force_curves(records).items():
        for number, step in enumerate(steps):
            writer.writerow((run.digest[:12], task, number, *vars(step).values()))
    write_file(directory / FORCES_FILE, text.getvalue())


def read_forces(run: Run, directory: Path) -> ForceCurves:
    """Read ``forces.csv``; empty where there is none, or none of this run's episodes."""
    curves: dict[str, list[ForceStep]] = {}
    try:
        content = read_file(directory / FORCES_FILE).decode()
        for row in csv.DictReader(io.StringIO(content)):
            steps = curves.setdefault(row["task"], [])
            values = [float(row[name]) for name in COLUMNS[4:]]
            same = row["run"] == run.digest[:12] and int(row["step"]) == len(steps)
            if not same or not all(map(math.isfinite, values)):
                return {}
            steps.append(ForceStep(int(row["episodes"]), *values))
    except (OSError, ValueError, KeyError, TypeError, csv.Error):  # a view that somebody edited
        return {}
    return curves
