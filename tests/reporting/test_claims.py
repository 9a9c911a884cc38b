"""What a study's claims need to be confirmed, and what is said of those that are not."""

from itertools import combinations, product

import numpy as np
import pandas as pd
import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.reporting.claims import (
    Claim,
    claims_frame,
    claims_table,
    detectable_shift,
    judge_claims,
)

PUSHING = Claim("success", ("pushing",), "hac", ("rnd-touch", "rnd"))
HIGH = (0.5, 0.6, 0.7, 0.8, 0.9)
LOW = (0.0, 0.1, 0.2, 0.3, 0.4)


def values(metric="success", task="pushing", **methods):
    rows = [
        (task, method.replace("_", "-"), seed, metric, value)
        for method, seeds in methods.items()
        for seed, value in enumerate(seeds)
    ]
    return pd.DataFrame(rows, columns=["task", "method", "seed", "metric", "value"])


def judge(claim, frame, family=1, **options):
    """Judge a claim in a family that has others, about which nothing is known yet."""
    others = [Claim("success", ("opening",), "hac", (f"m{i}",)) for i in range(family - 1)]
    return judge_claims([claim, *others], frame, **options)[0]


def test_five_seeds_without_overlap_bear_a_family_of_twelve_and_no_more():
    frame = values(hac=HIGH, rnd_touch=LOW, rnd=LOW)
    assert judge(PUSHING, frame).p_adjusted == pytest.approx(1 / 252)  # of the ways to share out
    assert judge(PUSHING, frame, family=12).verdict == "confirmed"
    assert judge(PUSHING, frame, family=13).verdict == "not decided"


def test_a_claim_against_two_methods_needs_both_comparisons():
    judged = judge(PUSHING, values(hac=HIGH, rnd_touch=HIGH, rnd=LOW))
    assert [one.p for one in judged.comparisons] == pytest.approx([148 / 252, 1 / 252])
    assert judged.p_adjusted == judged.comparisons[0].p
    assert judged.verdict == "not decided"


def test_a_claim_is_contradicted_where_every_comparison_is_the_other_way_round():
    judged = judge(PUSHING, values(hac=LOW, rnd_touch=HIGH, rnd=HIGH), family=12)
    assert judged.p_reversed_adjusted == pytest.approx(12 / 252)
    assert judged.verdict == "contradicted"
    assert str(claims_table([judged]).rows[0].cells[-2]) == "0.048"
    assert judge(PUSHING, values(hac=LOW, rnd_touch=HIGH, rnd=LOW)).verdict == "not decided"


def test_a_claim_on_several_tasks_needs_them_all():
    claim = Claim("success", ("pushing", "opening"), "hac", ("sac",))
    frame = pd.concat(
        [values(hac=HIGH, sac=LOW), values(task="opening", hac=HIGH, sac=(0.45, *LOW[1:]))]
    )
    assert judge(claim, frame).verdict == "confirmed"
    frame.loc[frame["task"] == "opening", "value"] = 0.5
    judged = judge(claim, frame)
    assert (judged.p_adjusted, judged.verdict) == (1.0, "not decided")


def test_fewer_steps_are_better():
    claim = Claim("episode_steps", ("pushing",), "hac", ("rnd",))
    few = values("episode_steps", hac=(20, 30, 25, 28, 21), rnd=(90, 80, 85, 200, 70))
    assert judge(claim, few).verdict == "confirmed"


def test_holm_corrects_over_all_claims():
    claims = [Claim("success", ("pushing",), "hac", (other,)) for other in ("rnd", "sac", "icm")]
    frame = values(hac=HIGH, rnd=LOW, sac=(*LOW[:4], 0.55), icm=HIGH)
    found = [one.p_adjusted for one in judge_claims(claims, frame)]
    assert found == pytest.approx([3 / 252, 4 / 252, 148 / 252])


def test_a_claim_waits_for_its_trainings_and_still_counts():
    claims = [PUSHING, Claim("success", ("pushing",), "hac", ("sac",))]
    frame = values(hac=HIGH, rnd_touch=LOW, rnd=LOW, sac=LOW)
    first, second = judge_claims(claims, frame, waiting=claims[1:])
    assert (first.verdict, first.p_adjusted) == ("confirmed", pytest.approx(2 / 252))
    assert (second.verdict, second.p_adjusted) == ("waiting", 1.0)
    assert claims_frame([second])[["worse", "better_seeds", "verdict"]].to_numpy().tolist() == [
        ["sac", 0, "waiting"]
    ]
    assert [str(cell) for cell in claims_table([second]).rows[0].cells] == [
        "hac > sac", "—", "0.733, —", "—", "—", "waiting",
    ]  # fmt: skip
    assert [claims_table([one]).notes[-1].startswith("Waiting") for one in (first, second)] == [
        False, True,
    ]  # fmt: skip


def test_a_metric_that_a_method_lacks_decides_nothing():
    judged = judge(PUSHING, values(hac=HIGH, rnd=LOW))
    assert (judged.p_adjusted, judged.verdict) == (1.0, "not decided")


def test_a_training_is_counted_once():
    twice = pd.concat([values(hac=HIGH, rnd_touch=LOW, rnd=LOW)] * 2)
    with pytest.raises(ValueError, match="two values"):
        judge(PUSHING, twice)


def test_one_seed_decides_nothing():
    judged = judge(PUSHING, values(hac=(1.0,), rnd_touch=(0.0,), rnd=(0.0,)))
    assert (judged.p_adjusted, judged.verdict) == (1.0, "not decided")
    assert np.isnan(judged.detectable)


@pytest.mark.parametrize("level", [0.05, 0.016, 0.004])
def test_the_detectable_shift_has_a_power_of_80_percent(level):
    """Counted here with other samples than there, and with the test written out."""
    shift = detectable_shift(5, 5, level)
    rng = np.random.default_rng(7)
    better, worse = rng.standard_normal((4000, 5, 1)) + shift, rng.standard_normal((4000, 1, 5))
    wins = (better > worse).sum(axis=(1, 2))
    orders = [
        sum(i > j for i, j in product(first, set(range(10)) - {*first}))
        for first in map(set, combinations(range(10), 5))
    ]
    p_values = np.array([np.mean(np.array(orders) >= count) for count in wins])
    assert np.mean(p_values <= level) == pytest.approx(0.8, abs=0.03)


def test_where_equal_methods_vary_unequally_a_strict_test_errs_up_to_five_times_as_often():
    """As NOTES says: five seeds each, equal means, and the smallest p-value that there is."""
    rng = np.random.default_rng(3)
    equal, wide = (spread * rng.standard_normal((200_000, 5)) for spread in (1, 10))
    errors = [np.mean(one.min(axis=1) > other.max(axis=1)) for one, other in
              ((wide, equal), (equal, wide), (equal, wide / 10))]  # fmt: skip
    level = 1 / 252
    assert errors[2] == pytest.approx(level, rel=0.1)
    assert errors[:2] == [pytest.approx(5 * level, rel=0.1)] * 2


def test_a_test_that_can_never_reject_detects_nothing():
    assert np.isnan(detectable_shift(3, 3, 0.01))  # its smallest p-value is 0.05


def test_the_detectable_difference_grows_with_the_spread_of_the_seeds():
    def detectable(*spread):
        frame = values(hac=[0.8 + one for one in spread], rnd=[0.2 + one for one in spread])
        return judge(Claim("success", ("pushing",), "hac", ("rnd",)), frame).detectable

    narrow, wide = detectable(-0.02, -0.01, 0, 0.01, 0.02), detectable(-0.2, -0.1, 0, 0.1, 0.2)
    assert wide == pytest.approx(10 * narrow)
    assert np.isnan(detectable(0, 0, 0, 0, 0))
    assert np.isnan(detectable(-0.8, -0.7, 0, 0.7, 0.8))  # a share cannot differ so much


def test_table_and_file_show_ours_beside_the_paper_s():
    judged = [judge(PUSHING, values(hac=HIGH, rnd_touch=LOW, rnd=LOW))]
    (row,) = claims_table(judged).rows
    assert row.heads == ("Pushing", "Success")
    texts = [str(cell) for cell in row.cells]
    assert texts[:3] == ["hac > rnd-touch, rnd", "0.700, 0.200, 0.200", "0.733, 0.710, 0.582"]
    assert texts[4:] == ["0.004", "confirmed"]
    frame = claims_frame(judged)
    assert frame["worse"].tolist() == ["rnd-touch", "rnd"]
    assert frame["better_seeds"].tolist() == [5, 5]
    assert frame["p_of_comparison"].tolist() == pytest.approx([1 / 252] * 2)


@pytest.mark.parametrize(
    ("claim", "words"),
    [
        (("luck", ("pushing",), "hac", ("rnd",)), "no metric 'luck'"),
        (("success", (), "hac", ("rnd",)), "at least one"),
        (("success", ("pushing",), "hac", ()), "at least one"),
        (("success", ("pushing",), "hac", ("rnd", "rnd")), "twice"),
        (("success", ("pushing",), "hac", ("hac",)), "twice"),
        (("success", ("playing",), "hac", ("rnd",)), "no better direction in 'playing'"),
        (("touch_interaction", ("pushing",), "hac", ("rnd",)), "no better direction"),
    ],
)
def test_claims_that_cannot_be_judged_are_refused(claim, words):
    with pytest.raises(UsageError, match=words):
        Claim(*claim)
