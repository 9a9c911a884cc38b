"""The analysis of the study of touch, on values of which the answer is known."""

from itertools import combinations, product

import numpy as np
import pandas as pd
import pytest

from experiments.analysis import changes_of, join_seeds, read_rows
from experiments.grid import KEY, check_lock, read_design
from experiments.light import analysis as light
from experiments.touch.analysis import (
    DESIGN,
    FROZEN,
    answer,
    detectable,
    judge_pooled,
    stratified_p,
    touch_numbers,
    values_of,
)

MEASURE = {"pushing": "success", "pick-up": "success"}
CLAIMS = [
    {"better": better, "worse": worse, "measure": MEASURE}
    for better, worse in (("hac", "rnd"), ("rnd", "sac"))
]


def test_the_p_value_is_that_of_every_division_of_the_seeds_of_equal_numbers():
    rng = np.random.default_rng(5)
    better, worse = ([rng.integers(0, 20, 3) / 100 for _ in range(2)] for _ in range(2))
    every = [
        [sum(part) for part in combinations([*one, *other], 3)]
        for one, other in zip(better, worse, strict=True)
    ]
    sums = [sum(pair) for pair in product(*every)]
    seen = sum(float(one.sum()) for one in better)
    assert stratified_p(better, worse) == pytest.approx(np.mean([s >= seen - 1e-9 for s in sums]))
    same = [np.full(8, 0.5)]
    assert stratified_p(same, same) == pytest.approx(1.0)
    apart = [np.linspace(0.6, 0.9, 8)], [np.linspace(0.1, 0.4, 8)]
    assert stratified_p(*apart) == pytest.approx(1 / 12870)
    with pytest.raises(ValueError, match="7 of the other"):
        stratified_p([np.full(8, 0.5)], [np.full(7, 0.5)])


def known(**means):
    rng = np.random.default_rng(5)
    return {
        (arm, task, "success"): np.clip(mean + rng.normal(0, 0.05, 8), 0, 1).round(2)
        for arm, mean in means.items()
        for task in MEASURE
    }


def test_single_tasks_are_decided_only_inside_a_decided_claim():
    judged = judge_pooled(CLAIMS, known(hac=0.8, rnd=0.4, sac=0.4)).set_index(["claim", "task"])
    assert {*judged.loc[1, "verdict"]} == {"confirmed"}
    assert [*judged.loc[2, "verdict"]] == ["not decided", "not tested", "not tested"]
    assert judged["difference"].tolist() == pytest.approx(
        (judged["better_mean"] - judged["worse_mean"]).tolist()
    )
    assert (judged["low"] < judged["difference"]).all()
    assert (judged["difference"] < judged["high"]).all()
    assert judged["p"].isna().tolist() == [False] * 4 + [True] * 2
    values = known(hac=0.4, rnd=0.8, sac=0.8)
    values["rnd", "pushing", "success"] = values["hac", "pushing", "success"]
    judged = judge_pooled(CLAIMS[:1], values).set_index("task")["verdict"]
    assert judged.loc[["", "pushing", "pick-up"]].tolist() == [
        "contradicted", "not contradicted", "contradicted"
    ]  # fmt: skip
    values["rnd", "pushing", "success"] = values["hac", "pushing", "success"] - 0.1
    found = judge_pooled(CLAIMS[:1], values).set_index("task").loc["pushing", "verdict"]
    assert found == "not contradicted, opposite sign"


def test_whole_seeds_keep_the_level_where_a_seed_is_alike_in_all_tasks():
    found, rng = [], np.random.default_rng(0)
    for _ in range(400):
        one, other = rng.normal(0.5, 0.1, (2, 8)).round(3)  # equal arms
        found.append((stratified_p([one, one], [other, other]), stratified_p([one], [other])))
    by_tasks, whole = np.mean(np.array(found) <= 0.05, axis=0)
    assert whole <= 0.07 < by_tasks
    values = {
        (arm, task, "success"): seeds
        for arm, seeds in (("hac", one), ("rnd", other))
        for task in MEASURE
    }
    judged = judge_pooled(CLAIMS[:1], values).iloc[0]
    assert judged[["p", "p_whole_seeds"]].tolist() == pytest.approx([*found[-1]])


def test_a_study_that_lacks_a_training_is_not_judged(tmp_path):
    pd.DataFrame(columns=KEY).to_csv(tmp_path / "trainings.csv", index=False)
    with pytest.raises(SystemExit, match="lacks 144 of 144 trainings"):
        values_of(read_design(DESIGN), tmp_path)


def test_the_detectable_difference_is_found_by_the_exact_test():
    rng = np.random.default_rng(5)
    spread = [rng.normal(0.5, 0.1, 8)], [rng.normal(0.5, 0.1, 8)]
    shift = detectable(*spread, 0.01)
    deviation = np.sqrt(np.mean([one[0].var(ddof=1) for one in spread]))
    found = [
        stratified_p(
            [rng.normal(0.5 + shift, deviation, 8)], [rng.normal(0.5, deviation, 8)]
        ) <= 0.01
        for _ in range(200)
    ]  # fmt: skip
    assert np.mean(found) == pytest.approx(0.8, abs=0.1)


def test_both_parts_of_the_touch_number_add_up_to_all_of_it():
    means = {"hac": 0.9, "hac-no-forces": 0.7, "rnd": 0.4, "rnd-no-forces": 0.3}
    values = {
        (arm, "pushing", "success"): mean + np.linspace(-0.07, 0.07, 8)
        for arm, mean in means.items()
    }
    numbers = touch_numbers({"pushing": "success"}, values).set_index("part")
    parts = ["HaC, forces felt", "curiosity and forces", "of it, curiosity", "of it, forces felt"]
    assert numbers["difference"][parts].tolist() == pytest.approx([0.2, 0.6, 0.45, 0.15])
    all_of_it = numbers.loc["curiosity and forces"]  # Student's t with 14 degrees of freedom
    deviation = np.linspace(-0.07, 0.07, 8).std(ddof=1)
    assert all_of_it["high"] - all_of_it["low"] == pytest.approx(
        2 * 2.1448 * deviation * (2 / 8) ** 0.5, rel=1e-3
    )


def test_the_answer_has_the_means_and_p_of_its_claims():
    pairs = [("rnd-touch", "rnd"), ("hac", "rnd"), ("hac", "hac-no-forces")]
    claims = [{"better": one, "worse": other, "measure": MEASURE} for one, other in pairs]
    means = {"hac": 0.8, "hac-no-forces": 0.79, "rnd-touch": 0.3, "rnd": 0.2}
    judged = judge_pooled(claims, known(**means))
    in_dark = pd.DataFrame({"better_mean": [0.9, 0.1], "worse_mean": [0.25, 0.2], "p": [0.02, 1]})
    design = {"pooled": claims, "seeds": range(8)}
    said = answer(design, judged, {"seeds": range(14)}, in_dark).splitlines()
    assert "success 0.900 and 0.250 (14 training seeds, p = 0.0200)" in said[0]
    of_claim = judged[judged["task"] == ""].set_index("claim")
    for line, claim in zip(said[1:], (3, 2), strict=True):
        for mean in of_claim.loc[claim, ["better_mean", "worse_mean"]]:
            assert f"{mean:.3f}" in line
    assert f"(8 training seeds, p = {of_claim.loc[3, 'p']:.4f})" in said[1]


def test_the_sentences_of_the_page_are_what_was_decided():
    """They are fixed words about the claims 2 and 7, one on light, and a fall in both tasks."""
    judged = pd.read_csv(DESIGN.with_name("pooled.csv"), keep_default_na=False).set_index(
        ["claim", "task"]
    )
    assert judged.loc[(2, ""), "verdict"] == "confirmed"
    assert judged.loc[(7, ""), "verdict"] == "not decided"
    in_dark = pd.read_csv(light.DESIGN.with_name("paired.csv"))
    assert in_dark["verdict"].iloc[0] == "confirmed"
    changes = join_seeds(changes_of(read_rows(DESIGN.parent, "episodes")))
    frozen = changes[(changes["method"] == "hac") & (changes["conditions"] == FROZEN)]
    assert (frozen["high"] < 0).all()


def test_a_locked_design_may_not_change(tmp_path):
    pd.DataFrame({"design": ["0" * 64]}).to_csv(tmp_path / "trainings.csv")
    check_lock({"digest": "1" * 64}, tmp_path)
    with pytest.raises(SystemExit, match="changed after it was locked"):
        check_lock({"locked": True, "digest": "1" * 64}, tmp_path)
