"""What is each sense worth to a policy? The locked studies of touch and of light in one table.

Every value is the mean success over training seeds in a suite's official episodes.
"""

from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import pandas as pd

from experiments.analysis import estimate_text, table_lines
from experiments.figures import COLORS, MARKS, SAME_BYTES, SHARE
from minitouch_bench.metrics.intervals import OVER_SEEDS
from minitouch_bench.reporting.labels import task_title

POLICIES = ("sees-and-feels", "sees", "feels", "neither")
"""By the senses of the task's policy; each is an arm of the study of light."""

IN_TOUCH = {"sees-and-feels": "hac", "sees": "hac-no-forces"}
"""The arms of the study of touch with these senses."""

LIGHT = {"table4": "on", "dark": "off"}
"""The light of a suite."""

SOLVED = 0.9
"""Mean success from which the page calls a task solved."""

WITHOUT = {"forces": "sees", "the picture": "feels", "both": "neither"}
"""What a policy does not have, and which policy that is."""

NOTE = (
    "Success in the suite's 100 official episodes, mean over training seeds, with a 95 % interval: "
    f"{OVER_SEEDS}. Where some seeds fail the intervals are too narrow. A dash: not trained. Every "
    "policy also has the positions of the hand and of its fingers. In Opening ([study of "
    "light](../light/light.md)) senses are left out in the task phase alone, after one exploration "
    "with all of them; in Pushing and Pick-up in both phases."
)


def worth_of(touch: pd.DataFrame, light: pd.DataFrame) -> pd.DataFrame:
    """Return the success of each policy in each task, light on and off.

    Args:
        touch: Estimates over seeds of the study of touch, as ``join_seeds`` returns them.
        light: Those of the study of light.

    Returns:
        A row per task, light and policy: the estimate, with ``setting`` and ``policy``.
    """
    lit = touch.assign(policy=touch["method"].map({arm: one for one, arm in IN_TOUCH.items()}))
    goals = ["pushing", "pick-up"]
    both = pd.concat([light.assign(policy=light["method"]), lit[lit["task"].isin(goals)]])
    is_asked = (both["metric"] == "success") & (both["conditions"] == "")
    worth = both[is_asked & both["suite"].isin(LIGHT) & both["policy"].isin(POLICIES)]
    titles = worth["task"].map(task_title)
    return worth.assign(setting=titles + ", light " + worth["suite"].map(LIGHT))


def worth_lines(worth: pd.DataFrame) -> list[str]:
    """Return the table of ``worth_of`` in Markdown, with its notes and its figure."""
    rows = [
        [
            str(setting),
            str(group["episodes"].iloc[0]),
            *(estimate_text(group[group["policy"] == one]) for one in POLICIES),
        ]
        for setting, group in worth.groupby("setting", sort=False)
    ]
    return [
        "## What each sense is worth",
        *table_lines(["Task", "Seeds", *(one.replace("-", " ") for one in POLICIES)], rows),
        "",
        f"- {' '.join(_solved_without(worth))}",
        f"- {NOTE}",
        "",
        "![Success by the senses of the policy, 95 % intervals](figures/senses.svg)",
    ]


def _solved_without(worth: pd.DataFrame) -> Iterator[str]:
    """Say for each sense in which settings the policy without it solves the task."""
    solved = worth[worth["value"] >= SOLVED]
    yield f"These are solved, with a mean success of {SOLVED} or more."
    for left_out, policy in WITHOUT.items():
        settings = "; ".join(solved.loc[solved["policy"] == policy, "setting"])
        yield f"Without {left_out}: {settings or 'none'}."


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
