"""Record the best and the worst episode of each task in runs, as ``RUN/videos/TASK-INDEX.mp4``.

``submit`` copies the videos of a run, and the page of the submission shows them.
"""

import sys
from pathlib import Path

from minitouch_bench.files import VIDEOS, make_folder, view_name
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.runs.run import Run, read_run
from minitouch_bench.verification.filming import film_to_files


def best_and_worst(run: Run, task: str) -> tuple[str, str]:
    """Return the keys of two episodes by what ranks the task; of equal ones, by fewer steps."""
    metric = METRICS[ranking_metric(task)]
    rows = [row for row in run.rows if row.task == task]
    rows.sort(key=lambda row: (float(metric.value(row) or 0.0), -row.steps, -row.index))
    return f"{task}/{rows[-1].index}", f"{task}/{rows[0].index}"


def main() -> None:
    """Record the videos of the runs that are named."""
    for directory in map(Path, sys.argv[1:]):
        run = read_run(directory)
        folder = make_folder(directory / VIDEOS)
        for task in run.plan.tasks:
            for key in best_and_worst(run, task):
                spec, _ = run.find(key)
                path = folder / view_name(key, ".mp4")
                film_to_files(run, (spec, [path]))
                print(path)


if __name__ == "__main__":
    main()
