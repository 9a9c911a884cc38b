import pytest

from minitouch_bench.reporting.charts import short_names, value_axis


@pytest.mark.parametrize(
    "names",
    [
        ("hac-seed1", "scripted"),
        ("short", "a name that is much too long for a plot"),
        tuple(f"hac-paper-seed3-step-{steps}" for steps in (100_000, 200_000, 300_000)),
        ("x" * 40 + "one" + "y" * 40, "x" * 40 + "two" + "y" * 40),
        tuple(f"{'x' * 30}{index}{'y' * 30}" for index in range(12)),
    ],
)
def test_names_that_differ_stay_different_and_fit(names):
    short = short_names(names)
    assert len(set(short)) == len(names)
    assert all(len(name) <= 16 for name in short)
    assert all(one == name for one, name in zip(short, names, strict=True) if len(name) <= 16)


@pytest.mark.parametrize(
    ("highest", "texts"),
    [
        (0, ["0", "1"]),
        (0.0007, ["0", "0.0002", "0.0004", "0.0006", "0.0008"]),
        (10_000, ["0", "2.5k", "5k", "7.5k", "10k"]),
    ],
)
def test_an_axis_has_round_numbers_and_counts_large_ones_in_thousands(highest, texts):
    axis = value_axis("x", highest)
    assert [tick.text for tick in axis.ticks] == texts
    assert (axis.low, axis.high) == (axis.ticks[0].at, axis.ticks[-1].at)
