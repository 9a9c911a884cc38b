import numpy as np
import pandas as pd
import pytest

from minitouch_bench.reporting.study_orders import judge_orders, orders_table


def values(metric, **methods):
    """Return the values of a study of Pushing; a method's are (seeds, episodes)."""
    rows = [
        ("pushing", method.replace("_", "-"), seed, 6000, metric, episode, float(value))
        for method, seeds in methods.items()
        for seed, episodes in enumerate(seeds)
        for episode, value in enumerate(episodes)
    ]
    names = ["task", "method", "seed", "steps", "metric", "episode", "value"]
    return pd.DataFrame(rows, columns=names)


def successes(*counts, episodes=20):
    return [[index < count for index in range(episodes)] for count in counts]


def test_three_seeds_without_overlap_just_reach_significance():
    found = judge_orders(
        values("exploration", hac=successes(6, 8, 10), rnd_touch=successes(2, 4, 2))
    )
    (row,) = found.to_dict("records")
    assert (row["better"], row["worse"]) == ("hac", "rnd-touch")
    assert row["better_value"] == pytest.approx(0.4)
    assert row["p_seeds"] == pytest.approx(1 / 20)  # one of the 20 ways to share out six values
    assert row["p_seeds_reversed"] == 1.0


def test_the_exact_test_bears_ties():
    found = judge_orders(values("success", hac=successes(3, 3, 3), rnd_touch=successes(3, 3, 3)))
    assert found[["p_seeds", "p_episodes"]].to_numpy().tolist() == [[1.0, 1.0]]


def test_few_steps_are_better_than_many():
    found = judge_orders(
        values("episode_steps", hac=[[20] * 9, [30] * 9], rnd_touch=[[200] * 9, [190] * 9])
    )
    (row,) = found.to_dict("records")
    assert row["p_seeds"] == pytest.approx(1 / 6)
    assert row["p_episodes"] == pytest.approx(1 / 2**9)  # every exchange is tried


def test_one_seed_tells_of_its_own_episodes_alone():
    found = judge_orders(values("success", hac=successes(18), sac=successes(2)))
    (row,) = found.to_dict("records")
    assert np.isnan(row["p_seeds"])
    assert row["p_episodes"] < 0.001
    assert row["p_episodes_reversed"] > 0.999


def test_one_episode_tells_nothing():
    found = judge_orders(values("success", hac=[[1]], sac=[[0]]))
    assert np.isnan(found[["p_seeds", "p_episodes"]].to_numpy()).all()
    assert "too few episodes" in str(orders_table(found).rows[0].cells[-1])


def test_only_episodes_of_both_methods_are_paired():
    found = judge_orders(
        values("success", hac=successes(5, episodes=5), rnd_touch=successes(0, episodes=20))
    )
    assert found["p_episodes"].tolist() == [pytest.approx(1 / 2**5)]


def test_the_table_says_what_holds():
    table = orders_table(
        pd.concat(
            [
                judge_orders(values("exploration", hac=successes(9, 9), rnd_touch=successes(1, 2))),
                judge_orders(values("success", rnd_touch=successes(1), rnd=successes(18))),
            ]
        )
    )
    first, second = ([str(cell) for cell in row.cells] for row in table.rows)
    assert first[:3] == ["hac > rnd-touch", "0.450 (2)", "0.075 (2)"]
    assert first[3:] == ["not significant (p = 0.167)", "holds (p = 0.004)"]
    assert second[3:] == [
        "not tested (too few seeds)",
        "does not hold (the opposite: p < 0.001)",
    ]
