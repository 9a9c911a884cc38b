import pytest

from minitouch_bench.reporting.charts import short_names


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
