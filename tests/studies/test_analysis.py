"""The stored studies: what is shown of them is what their stored rows give."""

import numpy as np
import pandas as pd
import pytest

from experiments.analysis import STUDIES, analyze, read_rows, stored_studies, write_results
from experiments.claims import detectable_shift, judge_claims
from experiments.grid import FILES, KEY, check_lock, read_design
from experiments.touch import analysis as touch

DESIGNS = {folder.name: folder / "design.toml" for folder in stored_studies()}
CLAIM = {"metric": "success", "tasks": ["pushing"], "better": "hac", "worse": ["rnd-touch", "rnd"]}
HIGH = (0.5, 0.6, 0.7, 0.8, 0.9)
LOW = (0.0, 0.1, 0.2, 0.3, 0.4)


@pytest.mark.parametrize("name", DESIGNS)
def test_the_stored_tables_follow_from_the_stored_rows(name):
    stored = STUDIES / name
    results = analyze(read_design(DESIGNS[name]), stored)
    assert results.report == (stored / "report.md").read_text(), "python -m experiments.analysis"
    if len(results.judged):
        assert results.judged.to_csv(index=False) == (stored / "claims.csv").read_text()


@pytest.mark.parametrize("name", DESIGNS)
def test_stored_estimates_are_means_of_stored_episodes(name):
    episodes, estimates = (read_rows(STUDIES / name, file) for file in ("episodes", "estimates"))
    columns = {"success": "success", "episode_steps": "steps", "touch_share": "touch_share"}
    run = [*KEY, "suite", "conditions"]
    for role, metric, column in [
        *(("final", *pair) for pair in columns.items()), ("exploration", "exploration", "success")
    ]:  # fmt: skip
        means = episodes[episodes["role"] == role].groupby(run)[column].agg(["mean", "size"])
        shown = estimates[estimates["metric"] == metric].set_index(run)
        both = shown.join(means)
        assert len(shown)
        assert both["value"].tolist() == pytest.approx(both["mean"].tolist())
        assert both["episodes"].tolist() == both["size"].tolist()


def test_the_page_about_touch_follows_from_the_stored_rows():
    stored, design = STUDIES / "touch", read_design(touch.DESIGN)
    check_lock(design, stored)
    results = touch.analyze_touch(design, stored)
    assert results.page == (stored / "touch.md").read_text(), "python -m experiments.touch.analysis"
    assert results.judged.to_csv(index=False) == (stored / "pooled.csv").read_text()


def test_results_are_written_beside_the_rows(tmp_path):
    """With a second length of exploration and a split of shapes, every figure is drawn."""
    for name in FILES:
        rows = read_rows(STUDIES / "touch", name)
        rows = rows[(rows["task"] == "pick-up") & (rows["training_seed"] < 22)]
        longer = rows.assign(exploration_steps=2 * rows["exploration_steps"])
        parts = [rows, longer]
        if name == "estimates":
            of_split = rows[(rows["metric"] == "success") & (rows["conditions"] == "")]
            parts += [
                of_split.assign(suite="novel-shapes", metric=f"success, {split}")
                for split in ("train", "held-out")
            ]
        pd.concat(parts).to_csv(tmp_path / f"{name}.csv", index=False)
    write_results(read_design(STUDIES / "methods" / "design.toml"), tmp_path)
    written = {file.name for file in tmp_path.rglob("*.*")}
    drawn = {"curves.svg", "movement.svg", "lengths.svg", "novel-shapes.svg", "conditions.svg"}
    assert {"report.md", *drawn} <= written


def values(metric="success", task="pushing", **methods):
    rows = [
        (task, method.replace("_", "-"), seed, metric, value)
        for method, seeds in methods.items()
        for seed, value in enumerate(seeds)
    ]
    return pd.DataFrame(rows, columns=["task", "method", "training_seed", "metric", "value"])


def judge(claim, frame, family=1):
    """Return verdict and p-values of a claim; nothing is known yet of the others of its family."""
    others = [{**CLAIM, "tasks": ["opening"], "worse": [f"m{i}"]} for i in range(family - 1)]
    judged = judge_claims([claim, *others], frame)
    of_claim = judged[judged["claim"] == 1]
    (verdict,) = {*of_claim["verdict"]}
    return verdict, of_claim["p_adjusted"].tolist(), of_claim["detectable"].tolist()


def verdict(*args):
    return judge(*args)[0]


def test_five_seeds_without_overlap_bear_a_family_of_twelve_and_no_more():
    frame = values(hac=HIGH, rnd_touch=LOW, rnd=LOW)
    assert judge(CLAIM, frame)[1] == pytest.approx([1 / 252] * 2)
    assert verdict(CLAIM, frame, 12) == "confirmed"
    assert verdict(CLAIM, frame, 13) == "not decided"


def test_a_claim_needs_every_comparison_in_every_task():
    assert verdict(CLAIM, values(hac=HIGH, rnd_touch=HIGH, rnd=LOW)) == "not decided"
    assert verdict(CLAIM, values(hac=HIGH, rnd=LOW)) == "not decided"  # one is missing
    both = {**CLAIM, "tasks": ["pushing", "opening"], "worse": ["sac"]}
    frame = pd.concat([values(hac=HIGH, sac=LOW), values(task="opening", hac=HIGH, sac=LOW)])
    assert verdict(both, frame) == "confirmed"
    frame.loc[frame["task"] == "opening", "value"] = 0.5
    assert verdict(both, frame) == "not decided"


def test_a_claim_is_contradicted_where_every_comparison_is_the_other_way_round():
    assert verdict(CLAIM, values(hac=LOW, rnd_touch=HIGH, rnd=HIGH), 12) == "contradicted"
    assert verdict(CLAIM, values(hac=LOW, rnd_touch=HIGH, rnd=LOW)) == "not decided"
    fewer = {**CLAIM, "metric": "episode_steps", "worse": ["rnd"]}
    few = values("episode_steps", hac=(20, 30, 25, 28, 21), rnd=(90, 80, 85, 200, 70))
    assert verdict(fewer, few) == "confirmed"


def test_fewer_than_five_seeds_decide_nothing():
    _, p_values, detectable = judge(CLAIM, values(hac=HIGH[:4], rnd_touch=LOW[:4], rnd=LOW[:4]))
    assert p_values == [1.0, 1.0]
    assert np.isnan(detectable).all()


def test_the_detectable_shift_has_a_power_of_80_percent():
    """Counted here with other samples than there, and the test by its rank sums."""
    shift = detectable_shift(5, 5, 1 / 252)  # the smallest p-value: no overlap
    rng = np.random.default_rng(7)
    better, worse = rng.standard_normal((4000, 5)) + shift, rng.standard_normal((4000, 5))
    assert np.mean(better.min(axis=1) > worse.max(axis=1)) == pytest.approx(0.8, abs=0.03)
    assert np.isnan(detectable_shift(3, 3, 0.01))  # its smallest p-value is 0.05
