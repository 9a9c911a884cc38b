"""What is touch for? Claims pooled over tasks, and the touch number, from the rows of the study.

Every value is the mean of one training seed's official episodes. The same rows give the same bytes:
``python -m experiments.touch.analysis``.
"""

from collections.abc import Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import scipy

from experiments.analysis import ABSENT, STUDIES, read_rows, table_lines, write_results
from experiments.figures import COLORS, SAME_BYTES
from experiments.grid import cells_of, check_lock, finished_cells, read_design
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.statistics import ALPHA, POWER, holm
from minitouch_bench.reporting.labels import task_title

DESIGN = Path(__file__).with_name("design.toml")

UNIT = 1e-4
"""Values are rounded to this share, so that sums are whole numbers and can be counted exactly."""

SIMULATED = 2_000
"""Studies in which a power is counted."""

Values = Mapping[tuple[str, str, str], np.ndarray]
"""The seeds' values, float64 (seeds,), by arm, task and metric."""

Sides = Sequence[Sequence[np.ndarray]]
"""The better arm's and the worse arm's seeds' values, task by task."""

COLUMNS = [
    "claim", "task", "verdict", "better_mean", "worse_mean", "p", "p_reversed", "detectable",
]  # fmt: skip
UNDECIDED, UNTRAINED = "not decided", "not trained"

NOTES = (
    "One-sided exact permutation tests of the sum of differences of means, stratified by task: "
    "within each task every division of the seeds' values between the two arms counts once. p: "
    "adjusted by Holm's method over the pooled claims; a single task is tested, with Holm's method "
    "over its claim's tasks, only where the pooled claim is decided, and in its direction.",
    "A claim is judged once every training of both arms is finished. The correction counts the "
    "claims that are not trained yet: a decided one stays decided when they are.",
    f"Confirmed: p ≤ {ALPHA}. Contradicted: the reverse has p ≤ {ALPHA}, with the same correction.",
    f"Detectable: the common difference that {100 * POWER:.0f} % of such studies show at the "
    "strictest level of the correction, if seeds vary as here (normal values, simulated).",
)

NUMBER_NOTE = (
    "Success (touch share in Playing) of `hac` less that of `rnd-no-forces`, which has no touch at "
    "all, with 95 % intervals over training seeds (Student's t). The two parts add up to it: each "
    "is the mean of the two comparisons that differ in its role alone (Shapley's division)."
)

FACTORS = {
    "exploring": (("hac", "rnd"), ("hac-no-forces", "rnd-no-forces")),
    "acting": (("hac", "hac-no-forces"), ("rnd", "rnd-no-forces")),
}
"""The arms with and without touch in one role; in the other role they differ alike."""


def stratified_p(better: Sequence[np.ndarray], worse: Sequence[np.ndarray]) -> float:
    """Return the exact one-sided p-value of the sum of differences of means over tasks.

    Args:
        better: For each task the seeds' values, float64 (n,), of the arm that is said to be better.
        worse: The same of the other arm; as many seeds.
    """
    sums, observed = [], 0
    for pair in zip(better, worse, strict=True):
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
        values: Those of the finished arms.

    Returns:
        A row per pooled claim, and below it one per task: claim, task ("" where pooled), the means
        of both arms over tasks and seeds, p, p_reversed (adjusted), detectable, verdict. A claim
        about an arm that is not finished has one row, without numbers.
    """
    arms = {arm for arm, _, _ in values}
    sides = {
        number: [
            [values[claim[side], task, metric] for task, metric in claim["measure"].items()]
            for side in ("better", "worse")
        ]
        for number, claim in enumerate(claims)
        if {claim["better"], claim["worse"]} <= arms
    }
    adjusted = dict(zip(sides, _adjusted([*sides.values()], len(claims)), strict=True))
    rows: list[dict[str, Any]] = []
    for number, claim in enumerate(claims):
        if number not in sides:
            rows.append({"claim": number, "task": "", "verdict": UNTRAINED})
            continue
        pooled, p_values = sides[number], adjusted[number]
        verdict = _verdict(p_values)
        rows.append(
            {"claim": number, "task": "", "verdict": verdict}
            | _numbers(pooled, p_values, len(claims))
        )
        singles = [[[one], [other]] for one, other in zip(*pooled, strict=True)]
        for task, single, p_single in zip(
            claim["measure"], singles, _adjusted(singles, len(singles)), strict=True
        ):
            is_alike = _verdict(p_single) == verdict
            rows.append(
                {"claim": number, "task": task, "verdict": verdict if is_alike else UNDECIDED}
                | _numbers(single, p_single, len(singles))
            )
    return pd.DataFrame(rows, columns=COLUMNS)


def _adjusted(sides: Sequence[Sides], family: int) -> list[tuple[float, float]]:
    """Return the p-values of comparisons, and of their reverses, each corrected as one family.

    The family's comparisons that are not made yet count as if their p-values were 1.
    """
    later = [1.0] * (family - len(sides))
    forward = holm([*(stratified_p(better, worse) for better, worse in sides), *later])
    backward = holm([*(stratified_p(worse, better) for better, worse in sides), *later])
    return [*zip(forward, backward, strict=True)][: len(sides)]


def _verdict(p_values: tuple[float, float]) -> str:
    p, p_reversed = p_values
    return "confirmed" if p <= ALPHA else "contradicted" if p_reversed <= ALPHA else UNDECIDED


def _numbers(sides: Sides, p_values: tuple[float, float], family: int) -> dict[str, float]:
    better, worse = (float(np.mean([one.mean() for one in side])) for side in sides)
    return {
        "better_mean": better, "worse_mean": worse, "p": p_values[0], "p_reversed": p_values[1],
        "detectable": detectable(*sides, ALPHA / family),
    }  # fmt: skip


def detectable(better: Sequence[np.ndarray], worse: Sequence[np.ndarray], level: float) -> float:
    """Return the difference, the same in every task, that the test shows with a chance of POWER.

    The permutation distribution is taken as normal, with its exact variance.
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
        reached = difference / np.maximum(deviation, 1e-12) >= scipy.stats.norm.isf(level)
        return float(reached.mean()) - POWER

    return float(scipy.optimize.bisect(excess, 0.0, 1.0, xtol=1e-4)) if excess(1.0) > 0 else np.nan


def touch_number(values: Values, task: str, metric: str) -> dict[str, tuple[float, float, float]]:
    """Return what touch is worth in a task: all of it, and the parts of exploring and acting.

    "all" is the mean of ``hac`` less that of the arm without any touch. Each part is the mean of
    its two comparisons in FACTORS (Shapley's division), so that both add up to all. Values with
    95 % intervals over training seeds: Student's t, Welch-Satterthwaite degrees of freedom. What
    needs an arm that is not finished is left out.
    """
    parts = {name: _contrast(pairs, 0.5) for name, pairs in FACTORS.items()}
    weights = {"all": _contrast((("hac", "rnd-no-forces"),), 1.0), **parts}
    return {
        name: _interval([(weight, values[arm, task, metric]) for arm, weight in of_arm.items()])
        for name, of_arm in weights.items()
        if all((arm, task, metric) in values for arm in of_arm)
    }


def _contrast(pairs: Sequence[tuple[str, str]], share: float) -> dict[str, float]:
    weights: dict[str, float] = {}
    for arms in pairs:
        for arm, sign in zip(arms, (share, -share), strict=True):
            weights[arm] = weights.get(arm, 0.0) + sign
    return weights


def _interval(weighted: Sequence[tuple[float, np.ndarray]]) -> tuple[float, float, float]:
    value = sum(weight * float(seeds.mean()) for weight, seeds in weighted)
    parts = [(weight**2 * seeds.var(ddof=1) / len(seeds), len(seeds)) for weight, seeds in weighted]
    variance = sum(part for part, _ in parts)
    if not variance:
        return value, value, value
    freedom = variance**2 / sum(part**2 / (count - 1) for part, count in parts)
    half = float(scipy.stats.t.ppf(1 - ALPHA / 2, freedom) * variance**0.5)
    return value, value - half, value + half


def values_of(design: Mapping[str, Any], directory: Path) -> Values:
    """Read the seeds' values of the official episodes of the arms that have all their trainings."""
    begun = {cell.method for cell in {*cells_of(design)} - finished_cells(directory)}
    rows = read_rows(directory, "estimates")
    main = rows[(rows["suite"] == "table4") & (rows["conditions"] == "")]
    main = main[~main["method"].isin(begun)]
    return {
        key: group["value"].to_numpy(float)
        for key, group in main.groupby(["method", "task", "metric"], sort=False)
    }


def report(design: Mapping[str, Any], directory: Path) -> tuple[str, pd.DataFrame]:
    """Return the claims and the touch number as a page of Markdown, and the judged claims."""
    values = values_of(design, directory)
    judged = judge_pooled(design["pooled"], values)
    cells, seeds = {*cells_of(design)}, len(design["seeds"])
    state = f"{len(cells & finished_cells(directory))} of {len(cells)} trainings are finished"
    arms = ", ".join(f"`{arm}`" for arm in dict.fromkeys(arm for arm, _, _ in values)) or "none"
    lines = ["# What is touch for?", "", f"{state}. Arms with all {seeds} seeds: {arms}.", ""]
    lines += [*_claim_lines(design, judged), *_number_lines(design, values)]
    return "\n".join(lines) + "\n", judged


def _claim_lines(design: Mapping[str, Any], judged: pd.DataFrame) -> list[str]:
    rows = []
    for row in judged.itertuples():
        claim = design["pooled"][row.claim]
        p = row.p_reversed if row.verdict == "contradicted" else row.p
        arms = f"{claim['better']} \\> {claim['worse']}"
        if row.verdict == UNTRAINED:
            rows.append([claim["name"], arms, *[ABSENT] * 3, UNTRAINED])
            continue
        rows.append(
            [
                claim["name"] if not row.task else f"&emsp;{task_title(row.task)}",
                arms,
                f"{row.better_mean:.3f}, {row.worse_mean:.3f}",
                ABSENT if np.isnan(row.detectable) else f"{row.detectable:.3f}",
                f"{p:.4f}" if p >= 0.0001 else "< 0.0001",
                row.verdict,
            ]
        )
    heads = ["Claim", "Arms", "Means over seeds and tasks", "Detectable", "p", "Verdict"]
    notes = ["", *(f"- {note}" for note in NOTES)]
    return ["## Claims", *table_lines(heads, rows, 2), *notes, ""]


def _number_lines(design: Mapping[str, Any], values: Values) -> list[str]:
    rows = []
    for task, metric in design["touch_number"].items():
        parts = touch_number(values, task, metric)
        cells = [
            f"{parts[part][0]:+.3f} [{parts[part][1]:+.3f}, {parts[part][2]:+.3f}]"
            if part in parts
            else ABSENT
            for part in PARTS
        ]
        rows.append([task_title(task), METRICS[metric].label, *cells])
    heads = ["Task", "Metric", "All of touch", "of it for exploring", "of it for acting"]
    picture = "![With touch minus without, with 95 % intervals](figures/touch-number.svg)"
    return [
        "## The touch number",
        *table_lines(heads, rows, 2),
        "",
        f"- {NUMBER_NOTE}",
        "",
        picture,
    ]


PARTS = {"all": "all of touch", "exploring": "for exploring", "acting": "for acting"}


def draw_number(design: Mapping[str, Any], values: Values, file: Path) -> None:
    """Draw the touch number of each task and its two parts, with their intervals."""
    drawn = [
        (task, metric, touch_number(values, task, metric))
        for task, metric in design["touch_number"].items()
    ]
    with mpl.rc_context(SAME_BYTES):
        figure, every = plt.subplots(
            1, len(drawn), figsize=(2.9 * len(drawn), 2.2), sharey=True, layout="constrained"
        )
        for axes, (task, metric, parts) in zip(every, drawn, strict=True):
            axes.axvline(0.0, color="gray", linewidth=0.8)
            for place, part in enumerate(PARTS):
                if part in parts:
                    value, low, high = parts[part]
                    axes.plot([low, high], [place] * 2, color=COLORS[place], linewidth=2)
                    axes.plot(value, place, "o", color=COLORS[place])
            axes.set(
                title=f"{task_title(task)}: {METRICS[metric].label.lower()}", xlim=(-1.05, 1.05)
            )
            axes.set(xlabel="with touch minus without", ylim=(len(PARTS) - 0.5, -0.5))
            axes.set_yticks(range(len(PARTS)), PARTS.values())
        figure.savefig(file, metadata={"Date": None, "Creator": None})
        plt.close(figure)


def main() -> None:
    """Write the tables and figures of the study from its stored rows."""
    design, directory = read_design(DESIGN), STUDIES / "touch"
    check_lock(design, directory)
    page, judged = report(design, directory)
    judged.to_csv(directory / "pooled.csv", index=False)
    write_results(design, directory)
    (directory / "touch.md").write_text(page, encoding="utf-8")
    draw_number(design, values_of(design, directory), directory / "figures" / "touch-number.svg")


if __name__ == "__main__":
    main()
