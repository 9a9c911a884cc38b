"""Touch-interaction in contact points, a reading of the paper's values: from stored actions.

``python -m experiments.contact_points`` replays the first episodes of each stored training and
prints, per 200 control steps, the contact points between arm and object at the ends of control
steps. The paper does not say what it counts; this unit comes near its values in some tasks.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

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


def contact_points(job: tuple[str, int, str, Role]) -> float:
    """Replay a training's first episodes of a task; return the points per STEPS control steps."""
    method, seed, task, role = job
    run = mt.load_run(SUBMISSIONS / method / f"seed-{seed}" / "table4")
    specs = [one for one in run.header.specs() if (one.task, one.role) == (task, role)]
    environment, points, steps = MiniTouchEnv(task), 0, 0
    for spec in specs[:EPISODES]:
        environment.reset(seed=spec.seed, options={"object": spec.shape})
        for action in run.actions_of(spec.key):
            environment.step(action)
            bodies = environment.arm.body, environment.task.target_body
            points += len(environment.client.contacts(*bodies))
            steps += 1
    environment.close()
    return STEPS * points / steps


def replayed() -> Iterator[tuple[str, int, str, Role]]:
    """Yield what is replayed: every training's policies of both roles; Playing has one."""
    for method in IN_PAPER:
        for folder in sorted((SUBMISSIONS / method).glob("seed-*")):
            for task in TASK_NAMES:
                for role in (Role.EXPLORATION, Role.FINAL):
                    if task != "playing" or role is Role.FINAL:
                        yield method, int(folder.name[5:]), task, role


def main() -> None:
    """Print a table: the mean over training seeds, the least and the largest, and the paper's."""
    jobs = [*replayed()]
    workers = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    points = dict(run_in_workers(contact_points, jobs, workers, name=str))
    rows = [(*job, points[index]) for index, job in enumerate(jobs)]
    frame = pd.DataFrame(rows, columns=["method", "seed", "task", "role", "points"])
    shown = []
    for (task, role), group in frame.groupby(["task", "role"], sort=False):
        by_method = [group[group["method"] == method]["points"] for method in IN_PAPER]
        cells = [f"{one.mean():.0f} ({one.min():.0f} to {one.max():.0f})" for one in by_method]
        printed = [paper_value(task, "touch_interaction", name) for name in IN_PAPER.values()]
        shown.append([task_title(task), str(role), *cells, *(value or ABSENT for value in printed)])
    heads = ["Task", "Policy", *IN_PAPER, *(f"{name} (paper)" for name in IN_PAPER.values())]
    print("\n".join(table_lines(heads, shown, 2)))


if __name__ == "__main__":
    main()
