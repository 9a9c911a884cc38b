"""Draw ``docs/pictures/curves.svg`` from the trainings in ``docs/curves/TASK-METHOD-SEED.csv``.

A method's name may carry what its settings change, as ``hac+previous``; the picture leaves it out.
With ``+log`` the first steps are gradient steps on recordings: only control steps are counted.
"""

from pathlib import Path

import pandas as pd

from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.rendering.figure_files import write_figures
from minitouch_bench.reporting.study_figures import learning_curves
from minitouch_bench.reporting.training_page import episode_success

DOCS = Path(__file__).parents[1] / "docs"


def read_curve(file: Path) -> pd.DataFrame:
    """Return the curve of one training, with what its file's name says."""
    task = next(name for name in TASK_NAMES if file.stem.startswith(f"{name}-"))
    name, _, seed = file.stem.removeprefix(f"{task}-").rpartition("-")
    method, _, _ = name.partition("+")
    rows = pd.read_csv(file)
    steps = rows.loc[rows["phase"] == "exploration", "step"].max()
    if "+log" in name and method != "sac":
        rows["step"] -= steps
        rows, steps = rows[rows["step"] > 0].reset_index(drop=True), 0
    kept = rows[["step", "touch_share"]].assign(success=episode_success(rows))
    return kept.assign(task=task, method=method, seed=int(seed), steps=steps)


def main() -> None:
    """Draw all curves, a plot per task and length of exploration."""
    curves = pd.concat(map(read_curve, sorted((DOCS / "curves").glob("*.csv"))))
    longest = curves.groupby("task")["steps"].transform("max")
    curves["steps"] = curves["steps"].fillna(longest).astype(int)  # sac
    for path in write_figures(tuple(learning_curves(curves)), DOCS / "pictures"):
        if path.suffix == ".pdf":
            path.unlink()


if __name__ == "__main__":
    main()
