import pytest

from minitouch_bench.comparison.settings import (
    LARGEST_ALPHA,
    SMALLEST_ALPHA,
    GateSettings,
    Tolerance,
)
from minitouch_bench.errors import UsageError


@pytest.mark.parametrize(
    "change",
    [
        {"alpha": 0.0},
        {"alpha": SMALLEST_ALPHA / 2},
        {"alpha": LARGEST_ALPHA * 2},
        {"alpha": float("nan")},
        {"metric": "flying"},
        {"metric": "arm_time"},  # of no table
        {"tolerance": Tolerance(1.0)},  # of a share
        {"tolerance": Tolerance(-0.1)},
        {"tolerance": Tolerance(float("nan"))},
        {"metric": "episode_steps", "tolerance": Tolerance(float("inf"))},
        {"strict": True, "lenient": True},
    ],
)
def test_a_value_without_meaning_is_refused_by_name(change):
    name = "strict" if "strict" in change else [*change][-1]
    with pytest.raises(UsageError, match=name):
        GateSettings(**change)


@pytest.mark.parametrize("alpha", [SMALLEST_ALPHA, LARGEST_ALPHA])
def test_the_ends_of_the_level_are_levels(alpha):
    assert GateSettings(alpha).alpha == alpha


@pytest.mark.parametrize(
    ("text", "tolerance"),
    [
        ("0.05", Tolerance(0.05)),
        (3, Tolerance(3.0)),
        (" 10% ", Tolerance(0.1, relative=True)),
    ],
)
def test_a_tolerance_is_a_number_or_a_percentage(text, tolerance):
    assert Tolerance.parse(text) == tolerance


@pytest.mark.parametrize("text", ["", "success=0.1", "%", "5 points"])
def test_what_is_neither_is_refused(text):
    with pytest.raises(UsageError, match="percentage"):
        Tolerance.parse(text)


def test_a_relative_tolerance_is_of_the_baseline_s_mean():
    assert Tolerance(0.1, relative=True).absolute(40.0) == 4.0
    assert Tolerance(0.1).absolute(40.0) == 0.1
    assert [str(Tolerance(0.1, relative=True)), str(Tolerance(0.05))] == ["10%", "0.05"]


def test_each_metric_has_a_usual_tolerance_that_another_replaces():
    assert GateSettings().tolerance_of("success") == Tolerance(0.05)
    assert GateSettings().tolerance_of("touch_share").relative
    assert GateSettings(tolerance=Tolerance(0.1)).tolerance_of("success") == Tolerance(0.1)
