"""How often the tests of starts err: 2,000 simulated reports per setting.

A report has the 100 official scenes of each task. Where success does not depend on the start, a
sentence in any of its maps is a false alarm; at most 5 % may have one. Power: the share of reports
that name the part of Pushing's starts in which success is lower.

    python -m benchmarks.start_errors [--reports 2000]
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Episode, Outcome
from minitouch_bench.metrics.starts import judge_starts, start_bins
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PUSHING
from minitouch_bench.runs.run import read_run

SCENES = Path(__file__).parents[1] / "reports/results/scripted/seed-0/table4"


@dataclass(frozen=True)
class Setting:
    """True success: ``usual``, and ``there`` in the bin of Pushing whose words contain ``where``.

    ``trainings`` play the same scenes. ``spread``: standard deviation of a scene's own success.
    """

    usual: float
    where: str = ""
    there: float = 0.0
    trainings: int = 1
    spread: float = 0.0


SETTINGS: Mapping[str, Setting] = {
    "success 0.97": Setting(0.97),
    "success 0.9": Setting(0.9),
    "success 0.5": Setting(0.5),
    "8 trainings, success 0.8, scenes differ": Setting(0.8, trainings=8, spread=0.2),
    "0.95, and 0.5 in front of the target": Setting(0.95, "in front of its", 0.5),
    "0.95, and 0.7 in the farthest quarter": Setting(0.95, "19.8 cm", 0.7),
    "8 trainings, 0.8, and 0.6 in the farthest quarter": Setting(0.8, "19.8 cm", 0.6, 8, 0.1),
}


def read_scenes() -> dict[str, list[Episode]]:
    """Return the official scenes of each task with a goal."""
    rows = read_run(SCENES).rows
    return {task: [row for row in rows if row.task == task] for task in GOAL_TASKS}


def draw_report(
    scenes: Mapping[str, Sequence[Episode]], setting: Setting, rng: np.random.Generator
) -> Iterator[tuple[str, list[Episode]]]:
    """Yield each task with its episodes."""
    for task, rows in scenes.items():
        chances = np.full(len(rows), setting.usual)
        if setting.where and task == PUSHING.name:
            chances[_members(rows, setting.where)] = setting.there
        chances = np.clip(chances + rng.normal(0, setting.spread, len(rows)), 0, 1)
        won = rng.random((setting.trainings, len(rows))) < chances
        yield (
            task,
            [
                replace(row, outcome=Outcome.SUCCESS if success else Outcome.STEP_LIMIT)
                for wins in won
                for row, success in zip(rows, wins, strict=True)
            ],
        )


def _members(rows: Sequence[Episode], words: str) -> NDArray[np.bool_]:
    (members,) = [found for name, found in start_bins(PUSHING.name, rows) if words in name]
    return members


def simulate(
    scenes: Mapping[str, Sequence[Episode]], setting: Setting, reports: int, seed: int = 0
) -> tuple[float, float]:
    """Return the shares of reports that say anything, and that name the right part of Pushing."""
    rng = np.random.default_rng(seed)
    said = right = 0
    for _ in range(reports):
        groups = list(draw_report(scenes, setting, rng))
        found = {
            task: test
            for (task, _), test in zip(groups, judge_starts(groups), strict=True)
            if test.is_found
        }
        said += bool(found)
        pushing = found.get(PUSHING.name)
        right += bool(setting.where and pushing and setting.where in pushing.where)
    return said / reports, right / reports


def main() -> None:
    """Print both shares of every setting."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reports", type=int, default=2000)
    reports = parser.parse_args().reports
    scenes = read_scenes()
    for name, setting in SETTINGS.items():
        said, right = simulate(scenes, setting, reports)
        named = f", {right:.1%} name the right part" if setting.where else ""
        print(f"{name}: {said:.1%} say something{named}", flush=True)


if __name__ == "__main__":
    main()
