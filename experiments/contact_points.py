"""Touch-interaction in contact points, a reading of the paper's values: from stored actions.

``python -m experiments.contact_points`` replays the first episodes of each stored training and
prints, per 200 control steps, the contact points between arm and object at the ends of control
steps. The paper does not say what it counts; this unit comes near its values in some tasks.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pandas as pd

import minitouch_bench as mt
from experiments.analysis import ABSENT, IN_PAPER, table_lines
from minitouch_bench.episode import Role
from minitouch_bench.processes import run_in_workers
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.reporting.labels import paper_value, task_title
from minitouch_bench.tasks.environment import MiniTouchEnv

SUBMISSIONS = Path(__file__).parents[1] / "submissions"
EPISODES, STEPS = 10, 200


class Replayed(NamedTuple):
    """The first episodes of a role and a task in a training's run."""

    method: str
    seed: int
    task: str
    role: Role

    def contact_points(self) -> float:
        """Replay the episodes, and return the contact points per STEPS control steps."""
        run = mt.load_run(SUBMISSIONS / self.method / f"seed-{self.seed}" / "table4")
        wanted = [one for one in run.header.specs() if one.role is self.role]
        specs = [one for one in wanted if one.task == self.task][:EPISODES]
        environment, points, steps = MiniTouchEnv(self.task), 0, 0
        for spec in specs:
            environment.reset(seed=spec.seed, options={"object": spec.shape})
            for action in run.actions_of(spec.key):
                environment.step(action)
                world = environment.client, environment.arm.body, environment.task.target_body
                points += len(world[0].contacts(*world[1:]))
                steps += 1
        environment.close()
        return STEPS * points / steps


def replayed() -> Iterator[Replayed]:
    """Yield what is replayed: every training's exploring and, in Playing, final policy."""
    for method in IN_PAPER:
        for folder in sorted((SUBMISSIONS / method).glob("seed-*")):
            for task in TASK_NAMES:
                for role in (Role.EXPLORATION, Role.FINAL):
                    if task != "playing" or role is Role.FINAL:
                        yield Replayed(method, int(folder.name[5:]), task, role)


def main() -> None:
    """Print a table: the mean over training seeds, the least and the largest, and the paper's."""
    jobs = [*replayed()]
    workers = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    points = dict(run_in_workers(Replayed.contact_points, jobs, workers, name=str))
    frame = pd.DataFrame([(*job, points[index]) for index, job in enumerate(jobs)])
    frame.columns = [*Replayed._fields, "points"]
    rows = []
    for (task, role), group in frame.groupby(["task", "role"], sort=False):
        by_method = [group[group["method"] == method]["points"] for method in IN_PAPER]
        cells = [f"{one.mean():.0f} ({one.min():.0f} to {one.max():.0f})" for one in by_method]
        printed = [paper_value(task, "touch_interaction", name) for name in IN_PAPER.values()]
        rows.append(
            [task_title(task), str(role), *cells, *(str(p.text) if p else ABSENT for p in printed)]
        )
    heads = ["Task", "Policy", *IN_PAPER, *(f"{name} (paper)" for name in IN_PAPER.values())]
    print("\n".join(table_lines(heads, rows, 2)))


if __name__ == "__main__":
    main()
