import pytest

from minitouch_bench.reporting.charts import (
    name_axis,
    share_axis,
    short_names,
    value_axis,
)


def test_checkpoints_of_one_training_keep_distinct_names():
    names = [f"hac-paper-seed3-step-{steps}" for steps in (100_000, 200_000, 300_000)]
    short = short_names(names)
    assert len(set(short)) == 3
    assert all(len(name) <= 16 for name in short)
    assert short[0].endswith("100000")


@pytest.mark.parametrize(
    "names",
    [
        ("a", "b"),
        ("short", "a name that is much too long for a plot"),
        ("x" * 40 + "one" + "y" * 40, "x" * 40 + "two" + "y" * 40),
        tuple(f"{'x' * 30}{index}{'y' * 30}" for index in range(12)),
    ],
)
def test_names_that_differ_stay_different_and_fit(names):
    short = short_names(names)
    assert len(set(short)) == len(names)
    assert all(len(name) <= 16 for name in short)


def test_a_name_that_fits_is_left_alone():
    assert short_names(["hac-seed1", "scripted"]) == ("hac-seed1", "scripted")


@pytest.mark.parametrize(
    ("highest", "end", "step"),
    [(0, 1, 1), (97, 100, 25), (1663.4, 2000, 500), (0.0007, 0.0008, 0.0002), (4, 4, 1)],
)
def test_an_axis_ends_at_a_round_number(highest, end, step):
    axis = value_axis("x", highest)
    assert (axis.low, axis.high) == pytest.approx((0, end))
    assert axis.ticks[1].at == pytest.approx(step)
    assert axis.ticks[-1].at == axis.high


@pytest.mark.parametrize(
    ("highest", "texts"),
    [(10_000, ["0", "2.5k", "5k", "7.5k", "10k"]), (2000, ["0", "500", "1000", "1500", "2000"])],
)
def test_an_axis_of_large_values_counts_in_thousands(highest, texts):
    assert [tick.text for tick in value_axis("x", highest).ticks] == texts


def test_shares_run_from_0_to_1_and_rows_from_the_top():
    assert (share_axis("x").low, share_axis("x").high) == (0, 1)
    rows = name_axis(["a", "b"], ["paper"])
    assert rows.low > rows.high
    assert [(tick.text, tick.tone) for tick in rows.ticks] == [
        ("a", "ink"),
        ("b", "ink"),
        ("paper", "muted"),
    ]
