"""What is each sense worth in Opening, light on and off? Claims paired by training seed.

The same rows give the same bytes: ``python -m experiments.light.analysis``.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from experiments.analysis import estimate_text, join_seeds, read_rows, table_lines
from experiments.figures import COLORS, SAME_BYTES, SHARE
from experiments.grid import check_complete, check_lock, in_task, read_design
from minitouch_bench.metrics.intervals import OVER_SEEDS, student_mean
from minitouch_bench.metrics.statistics import ALPHA, holm

DESIGN = Path(__file__).with_name("design.toml")

EARLY = 2_500
"""Control steps of the task phase in which early success is counted, as in the trials."""

OFFICIAL = 100
"""Official episodes of a policy."""

UNIT = 1e-6
"""Differences are rounded to this share, so that equal ones are equal in every order of adding."""

SIMULATED = 2_000
"""Studies in which a power is counted."""

EARLY_SUCCESS, TABLE4, DARK = "early success", "table4", "dark"

Values = Mapping[tuple[str, str], np.ndarray]
"""By arm and measure the seeds' values, float64 (seeds,), in the order of the training seeds.

A measure: ``EARLY_SUCCESS``, or the suite of which the official success is meant.
"""


def paired_p(better: np.ndarray, worse: np.ndarray) -> float:
    """Return the exact one-sided p-value of the sum of paired differences.

    It is the share of the 2^n changes of signs of the differences that give as large a sum
    (R. A. Fisher, "The Design of Experiments", 1935, section 21).

    Args:
        better: The seeds' values, float64 (n,), of the arm that is said to be better; n ≤ 30.
        worse: Those of the other arm, in the same order of seeds.
    """
    differences = np.rint((better - worse) / UNIT).astype(int)
    # Each sum is one of the first half of the seeds and one of the second.
    first, second = (_signed_sums(half) for half in np.array_split(differences, 2))
    below = np.searchsorted(np.sort(second), differences.sum() - first, side="left")
    return 1.0 - float(below.sum()) / (len(first) * len(second))


def _signed_sums(numbers: np.ndarray) -> np.ndarray:
    sums = np.zeros(1, int)
    for number in numbers:
        sums = np.concatenate([sums - number, sums + number])
    return sums


def measure_of(claim: Mapping[str, Any]) -> str:
    """Return the measure of a claim of the design."""
    return str(claim.get("suite", claim["measure"]))


def sides_of(claims: list[dict[str, Any]], values: Values) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return for each claim the seeds' values of the better and of the worse arm."""
    return [
        (values[claim["better"], measure_of(claim)], values[claim["worse"], measure_of(claim)])
        for claim in claims
    ]


def judge_paired(claims: list[dict[str, Any]], values: Values) -> pd.DataFrame:
    """Judge the claims as one family.

    Returns:
        A row per claim: its number, the means of both arms over seeds, their difference with its
        95 % interval, the seeds in which the better arm's value is larger and smaller, the p-value
        and the one of the reverse, each adjusted by Holm's method, and the verdict.
    """
    sides = sides_of(claims, values)
    forward = holm([paired_p(better, worse) for better, worse in sides])
    backward = holm([paired_p(worse, better) for better, worse in sides])
    rows = []
    for number, (better, worse) in enumerate(sides, 1):
        difference = student_mean((better - worse).tolist(), (-1.0, 1.0))
        p, reverse = forward[number - 1], backward[number - 1]
        rows.append(
            {
                "claim": number,
                "better_mean": better.mean(),
                "worse_mean": worse.mean(),
                "difference": difference.value,
                "low": difference.low,
                "high": difference.high,
                "seeds_larger": int((better > worse).sum()),
                "seeds_smaller": int((better < worse).sum()),
                "p": p,
                "p_reversed": reverse,
                "verdict": "confirmed" if p <= ALPHA
                else "contradicted" if reverse <= ALPHA else "not decided",
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def power_of(design: Mapping[str, Any], failed: float) -> list[float]:
    """Return for each claim the share of studies like this one that would confirm it.

    Each seed of a simulated study is a trial of the design, drawn with replacement, with the noise
    of its episodes. With probability ``failed`` its exploration finds no opening, and all four
    policies fail in the same way.
    """
    rng = np.random.default_rng(0)
    trials, seeds = design["trials"], len(design["seeds"])
    confirmed = np.zeros(len(design["paired"]))
    for _ in range(SIMULATED):
        drawn = rng.integers(len(trials["seeds"]), size=seeds)
        works = rng.random(seeds) >= failed
        values: dict[tuple[str, str], np.ndarray] = {}
        for arm in design["methods"]:
            won, of = np.array(trials["early"][arm])[drawn].T
            values[arm, EARLY_SUCCESS] = works * rng.binomial(of, won / of) / of
            shares = np.array(trials["success"][arm])[drawn]
            for suite in (TABLE4, DARK):
                values[arm, suite] = works * rng.binomial(OFFICIAL, shares) / OFFICIAL
        p_values = [paired_p(*sides) for sides in sides_of(design["paired"], values)]
        confirmed += np.array(holm(p_values)) <= ALPHA
    return [*(confirmed / SIMULATED)]


def values_of(design: Mapping[str, Any], directory: Path) -> Values:
    """Read the seeds' values from the rows of the study.

    Raises:
        SystemExit: the rows of a training of the design are missing.
    """
    check_complete(design, directory)
    rows = read_rows(directory, "estimates")
    success = rows[(rows["metric"] == "success") & (rows["conditions"] == "")]
    by_measure = {
        (arm, suite): group.set_index("training_seed")["value"]
        for (arm, suite), group in success.groupby(["method", "suite"])
    }
    curves = read_rows(directory, "curves")
    early = curves[curves["phase"] == "task"]
    early = early[early["step"] <= early["exploration_steps"] + EARLY]
    for arm, rows in early.groupby("method"):
        won, episodes = _count_by_seed(rows)
        by_measure[arm, EARLY_SUCCESS] = won / episodes
    return {key: one[design["seeds"]].to_numpy(float) for key, one in by_measure.items()}


def _count_by_seed(curves: pd.DataFrame) -> tuple["pd.Series[float]", "pd.Series[int]"]:
    """Return the successes and the episodes of rows of ``progress.csv``, by training seed."""
    won = (curves["success"].fillna(0.0) * curves["episodes"]).groupby(curves["training_seed"])
    return won.sum(), curves.groupby("training_seed")["episodes"].sum()


def check_trainings(design: Mapping[str, Any], directory: Path) -> None:
    """Exit where a training is not whole, or where the arms of a seed do not share an exploration.

    They share one where its policy is the same, bit for bit.
    """
    trainings = read_rows(directory, "trainings")
    explored = trainings.groupby("training_seed")["exploration_policy"]
    if (explored.nunique() > 1).any():
        sys.exit(f"{directory}: the arms of a training seed have different explorations")
    length = trainings["exploration_steps"] + in_task(design, "opening")["task_steps"]
    is_whole = trainings["control_steps"] == length
    if not (is_whole & (trainings["final_policy"] != trainings["exploration_policy"])).all():
        sys.exit(f"{directory}: a training has not ended its task phase")


@dataclass(frozen=True)
class LightResults:
    """What the study shows: its page in Markdown, and the judged claims."""

    page: str
    judged: pd.DataFrame


def analyze_light(design: Mapping[str, Any], directory: Path) -> LightResults:
    """Make the results of the study from its rows."""
    values = values_of(design, directory)
    check_trainings(design, directory)
    judged = judge_paired(design["paired"], values).round(12)
    lines = [
        "# What is each sense worth, light on and off?",
        "",
        "Opening: after one exploration with every sense, four policies per training seed learn "
        "the task with the senses named here. All of them know where the hand is and how far its "
        "fingers are open, which tells in part that a hand is blocked. All of them begin as a copy "
        "of the exploration policy as far as their senses permit, and a penalty that falls to 0 "
        "keeps them near its actions. This teacher has every sense, so the results are about "
        "policies that learn from such a teacher. The design was locked before the first training.",
        *_policy_lines(design, values, directory),
        "",
        "![Success in training by control steps](figures/senses.svg)",
        "",
        *_claim_lines(design, judged),
        "",
        *_seed_lines(design, values, directory),
    ]
    return LightResults("\n".join(lines) + "\n", judged)


def _policy_lines(design: Mapping[str, Any], values: Values, directory: Path) -> list[str]:
    success = success_over_seeds(directory).set_index(["method", "suite"])
    rows = []
    for arm in design["methods"]:
        official = [success[success.index == (arm, suite)] for suite in (TABLE4, DARK)]
        early = student_mean(values[arm, EARLY_SUCCESS].tolist(), (0.0, 1.0))
        early_text = f"{early.value:.3f} [{early.low:.3f}, {early.high:.3f}]"
        rows.append([f"*{arm.replace('-', ' ')}*", *map(estimate_text, official), early_text])
    heads = ["Policy", "Success, light on", "Success, light off", "Success in early training"]
    return [
        *table_lines(heads, rows),
        "",
        f"- Shares of episodes, with 95 % intervals: {OVER_SEEDS} (in early training: Student's t "
        f"alone), {len(design['seeds'])} seeds. Where some seeds fail and others succeed such "
        "intervals are too narrow.",
        f"- Light on: the {OFFICIAL} official episodes of `table4`. Light off: those of `dark`, "
        "for the policies that are trained without the picture.",
        f"- In early training: of the training episodes within the first {EARLY:,} control steps "
        "of the task phase.",
    ]


def success_over_seeds(directory: Path) -> pd.DataFrame:
    """Return the official success of each policy and suite, joined over training seeds."""
    rows = read_rows(directory, "estimates")
    return join_seeds(rows[(rows["metric"] == "success") & (rows["conditions"] == "")])


def _claim_lines(design: Mapping[str, Any], judged: pd.DataFrame) -> list[str]:
    rows = [
        [
            claim["name"],
            f"{claim['better']} \\> {claim['worse']}".replace("-", " "),
            f"{row.better_mean:.3f}, {row.worse_mean:.3f}",
            f"{row.difference:+z.3f} [{row.low:+z.3f}, {row.high:+z.3f}]",
            f"{row.seeds_larger}, {row.seeds_smaller}",
            f"{row.p_reversed if row.verdict == 'contradicted' else row.p:.4f}",
            row.verdict,
        ]
        for claim, row in zip(design["paired"], judged.itertuples(), strict=True)
    ]
    heads = ["Claim", "Policies", "Means over seeds", "Difference", "Seeds larger, smaller", "p"]
    power = design["power"]
    powers = "; ".join(
        f"{failed:.0%}: " + ", ".join(f"{one:.2f}" for one in claims)
        for failed, claims in zip(power["failed_explorations"], power["claims"], strict=True)
    )
    return [
        "## Claims",
        *table_lines([*heads, "Verdict"], rows, 2),
        "",
        "- Each claim is one exact, one-sided test, paired by training seed: the share of all "
        "changes of signs of the seeds' differences that give as large a sum. Holm's correction "
        f"over the four claims. Confirmed: p ≤ {ALPHA}; contradicted: p ≤ {ALPHA} for the reverse, "
        "corrected in the same way. A seed whose exploration found no opening counts.",
        "- Difference: of the means, with a 95 % interval over seeds (Student's t, paired), not "
        "corrected.",
        "- Power, simulated before the first training from four trials, for the share of "
        f"explorations that find no opening: {powers} (claims in the order of the table).",
    ]


def _seed_lines(design: Mapping[str, Any], values: Values, directory: Path) -> list[str]:
    curves = read_rows(directory, "curves")
    curves = curves[curves["method"] == design["methods"][0]]
    explored = curves[curves["phase"] == "exploration"]
    openings, episodes = _count_by_seed(explored)
    rows = [
        [
            str(seed),
            f"{openings[seed]:.0f} of {episodes[seed]}",
            *(f"{values[arm, TABLE4][place]:.2f}" for arm in design["methods"]),
            *(f"{values[arm, DARK][place]:.2f}" for arm in ("feels", "neither")),
            *(f"{values[arm, EARLY_SUCCESS][place]:.2f}" for arm in design["methods"]),
        ]
        for place, seed in enumerate(design["seeds"])
    ]
    names = [arm.replace("-", " ") for arm in design["methods"]]
    heads = ["Training seed", "Openings while exploring"]
    heads += [f"{name}, light on" for name in names]
    heads += ["feels, light off", "neither, light off", *(f"{name}, early" for name in names)]
    return ["## Every training seed", *table_lines(heads, rows)]


def draw_curves(design: Mapping[str, Any], directory: Path) -> None:
    """Draw the success of the task phase's training episodes, with 95 % intervals over seeds."""
    curves = read_rows(directory, "curves")
    task = curves[curves["phase"] == "task"]
    slots = np.ceil((task["step"] - task["exploration_steps"]) / 500) * 500
    with mpl.rc_context(SAME_BYTES):
        figure, axes = plt.subplots(figsize=(6.0, 3.2), layout="constrained")
        for color, arm in zip(COLORS, design["methods"], strict=False):
            own = task["method"] == arm
            by_seed = task[own].groupby([slots[own], "training_seed"])["success"].mean().unstack()
            means = [student_mean(row, (0.0, 1.0)) for row in by_seed.ffill().dropna().to_numpy()]
            at = by_seed.ffill().dropna().index
            axes.plot(at, [one.value for one in means], color=color, label=arm.replace("-", " "))
            low, high = ([getattr(one, end) for one in means] for end in ("low", "high"))
            axes.fill_between(at, low, high, color=color, alpha=0.15, linewidth=0)
        axes.axvline(EARLY, color="gray", linewidth=0.8)
        axes.set(ylim=SHARE, xlabel="Control steps of the task phase", ylabel="Success in training")
        figure.legend(loc="outside right center")
        file = directory / "figures" / "senses.svg"
        file.parent.mkdir(exist_ok=True)
        figure.savefig(file, metadata={"Date": None, "Creator": None})
        plt.close(figure)


def main() -> None:
    """Write the page and the figure of the study."""
    design, directory = read_design(DESIGN), DESIGN.parent
    check_lock(design, directory)
    results = analyze_light(design, directory)
    (directory / "light.md").write_text(results.page, encoding="utf-8")
    results.judged.to_csv(directory / "paired.csv", index=False)
    draw_curves(design, directory)


if __name__ == "__main__":
    main()
