"""What is each sense worth to a policy? The locked studies of touch and of light in one table.

Every value is the mean success over training seeds in a suite's official episodes.
"""

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from experiments.analysis import ABSENT, table_lines
from experiments.figures import COLORS, MARKS, SAME_BYTES, SHARE
from minitouch_bench.metrics.intervals import OVER_SEEDS, student_mean
from minitouch_bench.reporting.labels import task_title

POLICIES = ("sees-and-feels", "sees", "feels", "neither")
"""Arms of the study of light, by the senses of the task's policy."""

IN_TOUCH = {"sees-and-feels": "hac", "sees": "hac-no-forces"}
"""The arms of the study of touch with these senses."""

NOTE = (
    "Success in the 100 official episodes, mean over training seeds with a 95 % interval: "
    f"{OVER_SEEDS}. A dash: not trained. Every policy also has the positions of the hand and of "
    "its fingers. In Opening ([study of light](../light/light.md)) senses are left out in the task "
    "phase alone, after one exploration with all of them; in Pushing and Pick-up in both phases."
)


def worth_of(
    touch: Mapping[tuple[str, str, str], np.ndarray], light: Mapping[tuple[str, str], np.ndarray]
) -> pd.DataFrame:
    """Return the success of each policy in each task, light on and off.

    Args:
        touch: The seeds' values, float64 (seeds,), of the study of touch by arm, task and metric.
        light: Those of the study of light by arm and suite.

    Returns:
        A row per task, light and policy: ``setting``, ``policy``, ``value``, ``low``, ``high``,
        ``seeds``.
    """
    settings = {
        "Opening, light on": {one: light[one, "table4"] for one in POLICIES},
        "Opening, light off": {one: light[one, "dark"] for one in ("feels", "neither")},
    }
    for task in ("pushing", "pick-up"):
        settings[f"{task_title(task)}, light on"] = {
            policy: touch[arm, task, "success"] for policy, arm in IN_TOUCH.items()
        }
    rows = []
    for setting, policies in settings.items():
        for policy, seeds in policies.items():
            mean = student_mean(seeds.tolist(), (0.0, 1.0))
            rows.append((setting, policy, mean.value, mean.low, mean.high, len(seeds)))
    return pd.DataFrame(rows, columns=["setting", "policy", "value", "low", "high", "seeds"])


def worth_lines(worth: pd.DataFrame) -> list[str]:
    """Return the table of ``worth_of`` in Markdown, with its note and its figure."""
    rows = []
    for setting, group in worth.groupby("setting", sort=False):
        shown = {
            row.policy: f"{row.value:.3f} [{row.low:.3f}, {row.high:.3f}]"
            for row in group.itertuples()
        }
        rows.append(
            [
                str(setting),
                *(shown.get(policy, ABSENT) for policy in POLICIES),
                str(group["seeds"].iloc[0]),
            ]
        )
    heads = ["Task", *(policy.replace("-", " ") for policy in POLICIES), "Training seeds"]
    return [
        "## What each sense is worth",
        *table_lines(heads, rows),
        "",
        f"- {NOTE}",
        "",
        "![Success by the senses of the policy, 95 % intervals](figures/senses.svg)",
    ]


def draw_worth(worth: pd.DataFrame, file: Path) -> None:
    """Draw the success of each policy with its interval, a panel per task and light."""
    settings = [*worth.groupby("setting", sort=False)]
    with mpl.rc_context(SAME_BYTES):
        figure, every = plt.subplots(
            1, len(settings), figsize=(2.2 * len(settings), 1.8), sharey=True, layout="constrained"
        )
        for axes, (setting, group) in zip(every, settings, strict=True):
            for row in group.itertuples():
                place = POLICIES.index(row.policy)
                axes.plot([row.low, row.high], [place] * 2, "|-", color=COLORS[place], linewidth=2)
                axes.plot(row.value, place, MARKS[place], color=COLORS[place], markersize=5)
            axes.set(title=setting, xlabel="success", xlim=SHARE)
            axes.set_yticks(range(len(POLICIES)), [one.replace("-", " ") for one in POLICIES])
            axes.set_ylim(len(POLICIES) - 0.5, -0.5)
        figure.savefig(file, metadata={"Date": None, "Creator": None})
        plt.close(figure)
