"""The analysis of the study with the light on and off, on values of which the answer is known."""

from dataclasses import asdict
from itertools import product

import numpy as np
import pandas as pd
import pytest

from experiments.analysis import join_seeds
from experiments.grid import cells_of, read_design
from experiments.light.analysis import (
    DESIGN,
    analyze_light,
    draw_curves,
    paired_p,
    power_of,
    success_over_seeds,
)
from experiments.senses import draw_worth, worth_lines, worth_of
from minitouch_bench.metrics.intervals import wilson

KNOWN = {"sees-and-feels": 0.9, "sees": 0.6, "feels": 0.8, "neither": 0.2}
"""Success of each policy, in every suite and in training."""


def test_the_p_value_is_that_of_every_change_of_signs():
    rng = np.random.default_rng(3)
    better, worse = rng.integers(0, 5, (2, 9)) / 5  # with ties
    differences = better - worse
    sums = [float(np.dot(signs, differences)) for signs in product((-1, 1), repeat=9)]
    expected = np.mean([one >= differences.sum() - 1e-9 for one in sums])
    assert paired_p(better, worse) == pytest.approx(expected)
    assert paired_p(better, better) == 1.0
    assert paired_p(np.ones(20), np.zeros(20)) == pytest.approx(2**-20)


def wilson_of(share):
    """Return the columns of the estimate of a share of 100 episodes."""
    found = asdict(wilson(round(100 * share), 100))
    return {"episodes": found.pop("count"), "interval": found.pop("method"), **found}


def write_rows(directory, known):
    """Write the rows of a finished study: seeds differ a little, policies as in ``known``."""
    rng = np.random.default_rng(1)
    estimates, curves, trainings = [], [], []
    for cell in cells_of(read_design(DESIGN)):
        key = asdict(cell)
        share = known[cell.method] + round(rng.normal(0, 0.02), 2)
        suites = ["table4", "dark"] if cell.method in ("feels", "neither") else ["table4"]
        estimates += [
            {**key, "suite": suite, "conditions": "", "metric": "success", **wilson_of(share)}
            for suite in suites
        ]
        for step in range(500, 20_500, 500):
            phase = "exploration" if step <= 10_000 else "task"
            row = {"step": step, "phase": phase, "episodes": 10, "success": share}
            curves.append({**key, **row})
        trainings.append(
            {**key, "control_steps": 20_000, "exploration_policy": f"seed {cell.training_seed}"}
            | {"final_policy": cell.name}
        )
    rows = {"estimates": estimates, "curves": curves, "trainings": trainings}
    for name, one in rows.items():
        pd.DataFrame(one).to_csv(directory / f"{name}.csv", index=False)


def test_claims_are_confirmed_where_they_are_true_and_contradicted_where_they_are_reversed(
    tmp_path,
):
    write_rows(tmp_path, KNOWN | {"sees": 0.95})
    results = analyze_light(read_design(DESIGN), tmp_path)
    verdicts = ["confirmed", "confirmed", "contradicted", "confirmed"]
    assert results.judged["verdict"].tolist() == verdicts
    assert results.judged["difference"].tolist() == pytest.approx([0.6, 0.75, -0.05, 0.1], abs=0.03)
    for number in results.judged["better_mean"]:
        assert f"{number:.3f}" in results.page
    draw_curves(read_design(DESIGN), tmp_path)
    assert (tmp_path / "figures" / "senses.svg").stat().st_size > 10_000


def test_a_study_is_judged_only_with_all_trainings_whole_and_of_one_exploration(tmp_path):
    write_rows(tmp_path, KNOWN)
    design, file = read_design(DESIGN), tmp_path / "trainings.csv"
    whole = pd.read_csv(file)
    curves = pd.read_csv(tmp_path / "curves.csv")
    curves[curves["training_seed"] > 50].to_csv(tmp_path / "curves.csv", index=False)
    with pytest.raises(SystemExit, match=r"curves.csv lacks 4 of 56 trainings"):
        analyze_light(design, tmp_path)
    curves.to_csv(tmp_path / "curves.csv", index=False)
    whole.iloc[1:].to_csv(file, index=False)
    with pytest.raises(SystemExit, match="lacks 1 of 56 trainings"):
        analyze_light(design, tmp_path)
    whole.assign(exploration_policy=whole["method"]).to_csv(file, index=False)
    with pytest.raises(SystemExit, match="different explorations"):
        analyze_light(design, tmp_path)
    whole.loc[3, "control_steps"] = 10_000
    whole.to_csv(file, index=False)
    with pytest.raises(SystemExit, match="not ended its task phase"):
        analyze_light(design, tmp_path)


def test_what_each_sense_is_worth_has_both_studies(tmp_path):
    write_rows(tmp_path, KNOWN)
    rows = [
        {"task": task, "method": arm, "training_seed": seed, "exploration_steps": 1}
        | {"suite": "table4", "conditions": "", "metric": "success", **wilson_of(share)}
        for arm, share in {"hac": 0.75, "hac-no-forces": 0.5, "rnd": 0.1}.items()
        for task in ("opening", "pushing", "pick-up")
        for seed in range(8)
    ]
    worth = worth_of(join_seeds(pd.DataFrame(rows)), success_over_seeds(tmp_path))
    by_policy = worth.set_index(["setting", "policy"])["value"]
    assert by_policy["Opening, light off", "feels"] == pytest.approx(0.8, abs=0.03)
    assert by_policy["Pick-up, light on", "sees"] == 0.5
    assert len(by_policy) == 10
    lines = worth_lines(worth)
    assert sum("0.500 [" in line for line in lines) == 2
    assert sum("| 8 |" in line for line in lines) == 2
    assert any("Without forces: none. Without" in line for line in lines)
    worth = worth.assign(value=worth["value"] + 0.31)
    solved = "Without forces: Opening, light on."
    assert any(solved in line for line in worth_lines(worth))
    draw_worth(worth, tmp_path / "senses.svg")
    assert "Pushing, light on" in (tmp_path / "senses.svg").read_text()


def test_the_power_in_the_design_is_the_simulated_one():
    design = read_design(DESIGN)
    rows = zip(design["power"]["failed_explorations"], design["power"]["claims"], strict=True)
    for failed, powers in rows:
        assert power_of(design, failed) == pytest.approx(powers, abs=0.0051)
