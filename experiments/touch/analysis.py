"""What is touch for? Claims pooled over tasks, and the touch number, from the rows of the study.

Every value is the mean of one training seed's official episodes. The same rows give the same bytes:
``python -m experiments.touch.analysis``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import scipy

from experiments.analysis import (
    ABSENT,
    CONDITIONS_NOTE,
    changes_of,
    estimate_text,
    join_seeds,
    learned_seeds,
    read_rows,
    silent_note,
    table_lines,
)
from experiments.figures import COLORS, SAME_BYTES
from experiments.grid import check_complete, check_lock, read_design
from experiments.light import analysis as light
from experiments.senses import draw_worth, worth_lines, worth_of
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.intervals import OVER_SEEDS
from minitouch_bench.metrics.statistics import ALPHA, POWER, holm
from minitouch_bench.reporting.labels import task_title

DESIGN = Path(__file__).with_name("design.toml")

FROZEN = "without forces"
"""The condition in which the forces stay as they are at the reset."""

UNIT = 1e-4
"""Values are rounded to this share, so that sums are whole numbers and can be counted exactly."""

SIMULATED = 2_000
"""Studies in which a power is counted."""

Values = Mapping[tuple[str, str, str], np.ndarray]
"""The seeds' values, float64 (seeds,), by arm, task and metric."""

Sides = Sequence[Sequence[np.ndarray]]
"""The better arm's and the worse arm's seeds' values, task by task."""

COLUMNS = [
    "claim", "task", "better_mean", "worse_mean", "difference", "low", "high", "detectable", "p",
    "p_reversed", "verdict", "p_whole_seeds", "p_whole_seeds_reversed",
]  # fmt: skip
CONFIRMED, CONTRADICTED = "confirmed", "contradicted"
UNDECIDED, UNTESTED = "not decided", "not tested"

VARIANTS = (
    "Five variants, each with eight training seeds, differ in their curiosity and in whether the "
    "policy feels the finger forces (Opening has those that feel them):",
    *table_lines(
        ["Variant", "Rewarded while exploring", "The policy feels the forces"],
        [
            ["`hac`", "forces that the image does not predict", "yes"],
            ["`hac-no-forces`", "the same", "no, in both phases"],
            ["`rnd-touch`", "new images and touch", "yes"],
            ["`rnd`", "new images", "yes"],
            ["`rnd-no-forces`", "new images", "no, in both phases"],
        ],
        3,
    ),
)

NOTES = (
    "Each claim is one exact, one-sided test of the sum, over its tasks, of the differences of "
    "means, by permutation of the seeds between both variants within each task. One task alone can "
    "decide the sum. *Explores*: success of the exploration policy; in Playing its touch share, "
    "which is close to what HaC is paid for.",
    "Difference: with a 95 % interval over training seeds, not corrected. Detectable: the "
    f"difference in each task that {100 * POWER:.0f} % of such studies would confirm (simulated "
    "with normal values); for a single task only if its claim is decided.",
    f"Confirmed: p ≤ {ALPHA}, contradicted: p ≤ {ALPHA} for the reverse. p is corrected by Holm's "
    "method over all claims. A single task is tested only inside a decided claim, with the same "
    "correction over the claim's tasks; a dash means that it was not tested. The chance of one or "
    "more false confirmations of claims is at most 5 %, if equal variants have equal distributions "
    "and the values of one seed in several tasks are independent. *p, whole seeds* does not need "
    "this independence: it repeats the test with each seed's sum over the tasks. Where a variant "
    "fails in some seeds, no bound is known.",
    "All variants share, seed by seed, the scenes of the training, the first weights and the first "
    "1,000 actions, and all play the same official episodes: the results are about these scenes.",
    "A variant without forces lacks them in both phases, but still senses where the hand is and "
    "how far its fingers are open. `hac` and `rnd` differ in their whole curiosity. RND, "
    "[whose learning rate was raised later](../notebook.md#keypoints), explores Pushing less than "
    "random actions: a poor curiosity of RND can also confirm the last two claims.",
    "In the first 10,000 control steps of the task phase a penalty keeps the policy near the "
    "exploration policy, so poor exploration costs success too. Settings and lengths were chosen "
    "with `hac` on training seeds 100 to 103.",
    "The design, which names the claims, was locked before the first training. The tests were "
    "written before that and not changed; neither they nor their power are in the locked file. "
    "[What was added "
    "later](../notebook.md#the-study-of-touch): intervals, *p, whole seeds*, *HaC, forces felt*, "
    "what finished policies rely on, and the words of this page.",
)

NUMBER_NOTE = (
    "Success; in Playing the touch share, where more is not better by itself. *HaC, forces felt*: "
    "`hac` less `hac-no-forces`. *Curiosity and forces*: `hac` less `rnd-no-forces`. The last two "
    "columns add up to it; each is the mean of the two comparisons that differ in it alone "
    "(Shapley's division), so where these two differ the mean describes neither. The curiosities "
    "differ in more than touch. 95 % intervals over training seeds: Student's t, not corrected for "
    "their number, too narrow where few seeds fail."
)

RELIANCE_NOTE = (
    "A drop can mean that the policy uses the forces, or that their combination with the other "
    "senses is new to it. It does not show what a policy would have learned without forces. A seed "
    "that learned nothing has nothing to lose and counts with a change of 0. Means with 95 % "
    f"intervals, not corrected for their number: {OVER_SEEDS}. The intervals are too narrow "
    "where some seeds fail."
)

FELT, CURIOSITY = "HaC, forces felt", "of it, curiosity"
PARTS: Mapping[str, Mapping[str, float]] = {
    FELT: {"hac": 1.0, "hac-no-forces": -1.0},
    "curiosity and forces": {"hac": 1.0, "rnd-no-forces": -1.0},
    CURIOSITY: {"hac": 0.5, "rnd": -0.5, "hac-no-forces": 0.5, "rnd-no-forces": -0.5},
    "of it, forces felt": {"hac": 0.5, "hac-no-forces": -0.5, "rnd": 0.5, "rnd-no-forces": -0.5},
}
"""Differences of arms, the weight of each: what felt forces are worth in HaC; then HaC's curiosity
and felt forces together, and the part of each, which add up to it."""


def stratified_p(better: Sequence[np.ndarray], worse: Sequence[np.ndarray]) -> float:
    """Return the exact one-sided p-value of the sum of differences of means over tasks.

    Args:
        better: For each task the seeds' values, float64 (n,), of the arm that is said to be better.
        worse: The same of the other arm; as many seeds.

    Raises:
        ValueError: the arms have unequal numbers of seeds.
    """
    sums, observed = [], 0
    for pair in zip(better, worse, strict=True):
        if len(pair[0]) != len(pair[1]):
            raise ValueError(f"{len(pair[0])} seeds of one arm, {len(pair[1])} of the other")
        units = [np.rint(values / UNIT).astype(int) for values in pair]
        observed += int(units[0].sum() - np.concatenate(units).min() * len(units[0]))
        sums.append(_sums_of_half(np.concatenate(units)))
    # Arms are equally large, so the difference of means rises with the better arm's sum.
    chances = np.maximum(reduce(scipy.signal.fftconvolve, sums), 0.0)
    return float(min(1.0, chances[observed:].sum()))


def _sums_of_half(units: np.ndarray) -> np.ndarray:
    """Return the chance of each sum of a random half of whole numbers, above the smallest sum."""
    rest, half = units - units.min(), len(units) // 2
    counts = np.zeros((half + 1, int(np.sort(rest)[half:].sum()) + 1))
    counts[0, 0] = 1.0
    for value in rest:
        end = counts.shape[1] - value
        counts[1:, value:] += counts[:-1, :end].copy()
    chances: np.ndarray = counts[half] / counts[half].sum()
    return chances


def judge_pooled(claims: Sequence[Mapping[str, Any]], values: Values) -> pd.DataFrame:
    """Judge the pooled claims, then the single tasks of those that are decided.

    Args:
        claims: Those of the design: better, worse, and ``measure``, the metric of each task.
        values: Those of all arms.

    Returns:
        A row of COLUMNS per pooled claim, and below it one per task ("" where pooled): the means
        of both arms over tasks and seeds, their difference with its 95 % interval, the detectable
        difference, the adjusted p-values of the claim and of its reverse, NaN for the tasks of an
        undecided claim, the verdict, and both p-values with whole seeds, of the pooled claim alone.
    """
    sides = [
        [
            [values[claim[side], task, metric] for task, metric in claim["measure"].items()]
            for side in ("better", "worse")
        ]
        for claim in claims
    ]
    whole = [[[np.sum(side, axis=0)] for side in pooled] for pooled in sides]
    rows: list[list[Any]] = []
    for number, (claim, pooled, p_values, beside) in enumerate(
        zip(claims, sides, _adjusted(sides), _adjusted(whole), strict=True), 1
    ):
        verdict = _verdict(p_values)
        numbers = _numbers(pooled, len(claims), verdict)
        rows.append([number, "", *numbers, *p_values, verdict, *beside])
        singles = [[[one], [other]] for one, other in zip(*pooled, strict=True)]
        for task, single, p_single in zip(
            claim["measure"], singles, _adjusted(singles), strict=True
        ):
            numbers = _numbers(single, len(singles), verdict)
            tested, shown = p_single, _verdict_inside(verdict, p_single, single)
            if verdict == UNDECIDED:
                tested, shown = (np.nan, np.nan), UNTESTED
            rows.append([number, task, *numbers, *tested, shown, np.nan, np.nan])
    return pd.DataFrame(rows, columns=COLUMNS)


def _adjusted(sides: Sequence[Sides]) -> list[tuple[float, float]]:
    """Return the p-values of comparisons, and of their reverses, each corrected as one family."""
    forward = holm([stratified_p(better, worse) for better, worse in sides])
    backward = holm([stratified_p(worse, better) for better, worse in sides])
    return [*zip(forward, backward, strict=True)]


def _verdict(p_values: tuple[float, float]) -> str:
    p, p_reversed = p_values
    return CONFIRMED if p <= ALPHA else CONTRADICTED if p_reversed <= ALPHA else UNDECIDED


def _verdict_inside(whole: str, p_values: tuple[float, float], sides: Sides) -> str:
    """Return the verdict on a single task of a claim that is decided, in the claim's direction."""
    if _verdict(p_values) == whole:
        return whole
    difference = float(sides[0][0].mean() - sides[1][0].mean())
    is_opposite = difference < 0 if whole == CONFIRMED else difference > 0
    return f"not {whole}" + (", opposite sign" if is_opposite else "")


def _numbers(sides: Sides, family: int, verdict: str) -> list[float]:
    """Return both means, their difference with its interval, and what could be detected."""
    better, worse = (float(np.mean([one.mean() for one in side])) for side in sides)
    share = 1 / len(sides[0])
    weighted = [(share, one) for one in sides[0]] + [(-share, one) for one in sides[1]]
    higher, lower = sides[::-1] if verdict == CONTRADICTED else sides
    return [better, worse, *_interval(weighted), detectable(higher, lower, ALPHA / family)]


def detectable(better: Sequence[np.ndarray], worse: Sequence[np.ndarray], level: float) -> float:
    """Return the difference, the same in every task, that the test shows with a chance of POWER.

    The permutation distribution is taken as normal, with its exact variance.

    Raises:
        ValueError: no difference that the worse arm's mean leaves room for is shown as often.
    """
    rng = np.random.default_rng(0)
    pairs = [*zip(better, worse, strict=True)]
    seeds = len(pairs[0][0])
    spreads = [np.sqrt((one.var(ddof=1) + two.var(ddof=1)) / 2) for one, two in pairs]
    drawn = rng.standard_normal((SIMULATED, len(pairs), 2, seeds)) * np.reshape(
        spreads, (1, -1, 1, 1)
    )

    def excess(shift: float) -> float:
        moved = drawn + np.reshape([shift, 0.0], (1, 1, 2, 1))
        difference = np.subtract(*moved.mean(axis=3).transpose(2, 0, 1)).sum(axis=1)
        every = moved.reshape(SIMULATED, len(pairs), 2 * seeds)
        deviation = np.sqrt((every.var(axis=2, ddof=1) * 2 / seeds).sum(axis=1))
        reached = difference / deviation >= scipy.stats.norm.isf(level)
        return float(reached.mean()) - POWER

    room = 1.0 - max(float(one.mean()) for one in worse)
    return float(scipy.optimize.bisect(excess, 0.0, room, xtol=1e-4))


def touch_numbers(measures: Mapping[str, str], values: Values) -> pd.DataFrame:
    """Return what forces and curiosity are worth in each task, by the differences of PARTS.

    Args:
        measures: The metric of each task.
        values: Those of all arms.

    Returns:
        A row per task and part of PARTS: task, metric, part, difference, low, high. 95 % intervals
        over training seeds: Student's t, Welch-Satterthwaite degrees of freedom.
    """
    rows = []
    for (task, metric), (part, weights) in product(measures.items(), PARTS.items()):
        seeds = [(weight, values[arm, task, metric]) for arm, weight in weights.items()]
        rows.append((task, metric, part, *_interval(seeds)))
    return pd.DataFrame(rows, columns=["task", "metric", "part", "difference", "low", "high"])


def _interval(weighted: Sequence[tuple[float, np.ndarray]]) -> tuple[float, float, float]:
    difference = sum(weight * float(seeds.mean()) for weight, seeds in weighted)
    parts = [(weight**2 * seeds.var(ddof=1) / len(seeds), len(seeds)) for weight, seeds in weighted]
    variance = sum(part for part, _ in parts)
    freedom = variance**2 / sum(part**2 / (count - 1) for part, count in parts)
    half = float(scipy.stats.t.ppf(1 - ALPHA / 2, freedom) * variance**0.5)
    return difference, max(-1.0, difference - half), min(1.0, difference + half)


def values_of(design: Mapping[str, Any], directory: Path) -> Values:
    """Read the seeds' values of the official episodes, in the order of the training seeds.

    Raises:
        SystemExit: the rows of a training of the design are missing.
    """
    check_complete(design, directory)
    rows = read_rows(directory, "estimates").sort_values("training_seed", kind="stable")
    main = rows[(rows["suite"] == "table4") & (rows["conditions"] == "")]
    return {
        key: group["value"].to_numpy(float)
        for key, group in main.groupby(["method", "task", "metric"], sort=False)
    }


@dataclass(frozen=True)
class TouchResults:
    """What the study shows: its page in Markdown, the judged claims, the touch numbers.

    ``worth`` is the success with and without each sense, of the study of light as well.
    """

    page: str
    judged: pd.DataFrame
    numbers: pd.DataFrame
    worth: pd.DataFrame


def analyze_touch(design: Mapping[str, Any], directory: Path) -> TouchResults:
    """Make the results of the study from its stored rows and those of the study of light."""
    values = values_of(design, directory)
    judged = judge_pooled(design["pooled"], values).round(12)
    numbers = touch_numbers(design["touch_number"], values).round(12)
    episodes = read_rows(directory, "episodes")
    changes = join_seeds(changes_of(episodes))
    estimates, of_light = read_rows(directory, "estimates"), read_design(light.DESIGN)
    check_lock(of_light, light.DESIGN.parent)
    in_dark = light.analyze_light(of_light, light.DESIGN.parent).judged
    worth = worth_of(join_seeds(estimates), light.success_over_seeds(light.DESIGN.parent))
    lines = ["# What is touch for?", "", answer(design, judged, of_light, in_dark), ""]
    lines += [*worth_lines(worth), "", "## The study of touch", "", *VARIANTS, ""]
    lines += _claim_lines(design, judged, _learned_note(learned_seeds(estimates)))
    lines += [*_number_lines(design, numbers), ""]
    lines += _reliance_lines(design, episodes, changes)
    return TouchResults("\n".join(lines) + "\n", judged, numbers, worth)


def answer(
    design: Mapping[str, Any],
    judged: pd.DataFrame,
    of_light: Mapping[str, Any],
    in_dark: pd.DataFrame,
) -> str:
    """Return what both studies found, in three sentences that can be repeated.

    Args:
        design: The locked design of the study of touch.
        judged: What ``judge_pooled`` returns.
        of_light: The locked design of the study of light.
        in_dark: The judged claims of the study of light; the first claim is that of the dark.
    """
    learned, felt = (_success_claim(design, judged, "hac", one) for one in ("rnd", "hac-no-forces"))
    blind = next(in_dark.itertuples())
    return (
        "1. **In the dark, of policies that explored with every sense, those that feel forces open "
        f"the door more often**: success {blind.better_mean:.3f} and {blind.worse_mean:.3f} "
        f"({len(of_light['seeds'])} training seeds, p {_p_text(blind.p, '= ')}).\n"
        "2. **In the light, feeling forces was not shown to help in Pushing and Pick-up**: success "
        f"{felt.better_mean:.3f} with forces and {felt.worse_mean:.3f} without "
        f"({len(design['seeds'])} training seeds, p {_p_text(felt.p, '= ')}).\n"
        "3. **HaC, with its curiosity about forces, succeeds more in Pushing and Pick-up than RND, "
        f"with its curiosity about images**: success {learned.better_mean:.3f} and "
        f"{learned.worse_mean:.3f} ({len(design['seeds'])} training seeds, p "
        f"{_p_text(learned.p, '= ')})."
    )


def _success_claim(design: Mapping[str, Any], judged: pd.DataFrame, better: str, worse: str) -> Any:
    """Return the judged row of the claim that one arm succeeds more than another, all tasks."""
    (number,) = (
        place
        for place, claim in enumerate(design["pooled"], 1)
        if (claim["better"], claim["worse"]) == (better, worse)
        and {*claim["measure"].values()} == {"success"}
    )
    return next(judged[(judged["claim"] == number) & (judged["task"] == "")].itertuples())


def _interval_text(row: Any) -> str:
    return f"{row.difference:+z.3f} [{row.low:+z.3f}, {row.high:+z.3f}]"


def _p_text(p: float, equals: str = "") -> str:
    return f"{equals}{p:.4f}" if p >= 0.0001 else "< 0.0001"


def _learned_note(learned: Mapping[tuple[Any, ...], str]) -> str:
    """Say how many training seeds of each variant learned a task, which means alone do not show."""
    by_task: dict[str, list[str]] = {}
    for (task, _, method), count in learned.items():
        by_task.setdefault(task, []).append(f"`{method}` {count}")
    tasks = (f"{task_title(task)}: {', '.join(counts)}" for task, counts in by_task.items())
    link = "[learned](../../docs/reference/metrics.md#intervals)"
    return f"This is how many training seeds {link}. {'. '.join(tasks)}."


def _claim_lines(design: Mapping[str, Any], judged: pd.DataFrame, learned: str) -> list[str]:
    rows = []
    for number, group in judged.groupby("claim"):
        claim, decided = design["pooled"][int(number) - 1], group["verdict"].iloc[0]
        for row in group.itertuples():
            p, whole = row.p, row.p_whole_seeds
            if decided == CONTRADICTED:
                p, whole = row.p_reversed, row.p_whole_seeds_reversed
            name = f"&emsp;{task_title(row.task)}" if row.task else claim["name"]
            means = f"{row.better_mean:.3f}, {row.worse_mean:.3f}"
            rows.append(
                [
                    name,
                    f"{claim['better']} \\> {claim['worse']}",
                    means,
                    _interval_text(row),
                    f"{row.detectable:.3f}",
                    *(ABSENT if np.isnan(one) else _p_text(one) for one in (p, whole)),
                    row.verdict,
                ]
            )
    heads = ["Claim", "Variants", "Means over seeds and tasks", "Difference", "Detectable", "p"]
    heads += ["p, whole seeds", "Verdict"]
    notes = ["", *(f"- {note}" for note in (learned, *NOTES))]
    return ["## Claims", *table_lines(heads, rows, 2), *notes, ""]


def _number_lines(design: Mapping[str, Any], numbers: pd.DataFrame) -> list[str]:
    shown = {(row.task, row.part): _interval_text(row) for row in numbers.itertuples()}
    rows = [
        [task_title(task), METRICS[metric].label, *(shown[task, part] for part in PARTS)]
        for task, metric in design["touch_number"].items()
    ]
    table = table_lines(["Task", "Metric", *PARTS], rows, 2)
    figure = "![Differences between variants, 95 % intervals](figures/touch-number.svg)"
    return ["## The touch number", *table, "", f"- {NUMBER_NOTE}", "", figure]


def _reliance_lines(
    design: Mapping[str, Any], episodes: pd.DataFrame, joined: pd.DataFrame
) -> list[str]:
    """Return the table of what other forces than those felt change in finished policies."""
    played, count = [*dict.fromkeys(joined["conditions"])], design["reliance"]["episodes"]
    frozen = joined[(joined["method"] == "hac") & (joined["conditions"] == FROZEN)]
    falls = {row.task: f"{-row.value:.3f}" for row in frozen.itertuples()}
    unchanged = episodes[(episodes["suite"] == "table4") & (episodes["conditions"] == "")]
    unchanged = unchanged[(unchanged["role"] == "final") & (unchanged["index"] < count)]
    success = unchanged.groupby(["task", "method"])["success"].mean()
    rows = []
    for (task, method), group in joined.groupby(["task", "method"], sort=False):
        of_cell = (episodes["task"] == task) & (episodes["method"] == method)
        seeds = episodes[of_cell]["training_seed"].nunique()
        cells = [estimate_text(group[group["conditions"] == one]) for one in played]
        rows.append(
            [
                task_title(str(task)),
                f"`{method}`",
                str(seeds),
                f"{success[task, method]:.3f}",
                *cells,
            ]
        )
    notes = [RELIANCE_NOTE, CONDITIONS_NOTE, *silent_note(episodes)]
    return [
        "## What finished policies rely on",
        "",
        "HaC's finished policies fail more often when their forces are frozen: success falls by "
        f"{falls['pushing']} in Pushing and {falls['pick-up']} in Pick-up.",
        "",
        f"Success in the first {count} official episodes, and what other forces change of it:",
        *table_lines(["Task", "Variant", "Seeds", "no change", *played], rows, 2),
        "",
        *(f"- {note}" for note in notes),
    ]


def draw_numbers(numbers: pd.DataFrame, file: Path) -> None:
    """Draw the differences of PARTS in each task, with their intervals."""
    tasks = [rows for _, rows in numbers.groupby("task", sort=False)]
    with mpl.rc_context(SAME_BYTES):
        figure, every = plt.subplots(
            1, len(tasks), figsize=(2.9 * len(tasks), 0.9 + 0.33 * len(PARTS)), sharey=True,
            squeeze=False, layout="constrained",
        )  # fmt: skip
        for axes, rows in zip(every[0], tasks, strict=True):
            axes.axvline(0.0, color="gray", linewidth=0.8)
            for place, row in enumerate(rows.itertuples()):
                axes.plot([row.low, row.high], [place] * 2, "|-", color=COLORS[place], linewidth=2)
                axes.plot(row.difference, place, "o", color=COLORS[place], markersize=4)
            title = f"{task_title(row.task)}: {METRICS[row.metric].label.lower()}"
            axes.set(title=title, xlabel="difference between variants", xlim=(-1.05, 1.05))
            axes.set_yticks(range(len(PARTS)), [*PARTS])
            axes.set_ylim(len(PARTS) - 0.5, -0.5)
        figure.savefig(file, metadata={"Date": None, "Creator": None})
        plt.close(figure)


def main() -> None:
    """Write the tables and figures of the study from its stored rows."""
    design, directory = read_design(DESIGN), DESIGN.parent
    check_lock(design, directory)
    results = analyze_touch(design, directory)
    (directory / "touch.md").write_text(results.page, encoding="utf-8")
    results.judged.to_csv(directory / "pooled.csv", index=False)
    draw_numbers(results.numbers, directory / "figures" / "touch-number.svg")
    draw_worth(results.worth, directory / "figures" / "senses.svg")


if __name__ == "__main__":
    main()
