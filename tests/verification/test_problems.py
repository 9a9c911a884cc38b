import pytest

from minitouch_bench.errors import InfrastructureError, UnreadableFileError, UsageError
from minitouch_bench.verification.static_check import Problem, Problems, compare_values


def test_what_a_stranger_wrote_reaches_no_terminal_and_stays_short():
    text = str(Problem("\x1b[31m", "\x1b[2J\n" + "x" * 10_000))
    assert text.isprintable()
    assert len(text) < 500


def test_a_check_goes_on_and_equal_problems_count_once():
    problems = Problems()
    for _ in range(2):
        problems.add("a", "wrong", "correct it")
    with problems.caught("b"):
        raise UsageError("two\nlines")
    problems.add_below("c", [Problem("d", "also wrong")])
    assert [str(problem) for problem in problems] == [
        "a: wrong; correct it",
        "b: two lines",
        "c, d: also wrong",
    ]


def found(recorded, again):
    return [str(difference) for difference in compare_values("run", recorded, again)]


@pytest.mark.parametrize("value", [1, 1.5, "x", None, True, [1, [2]], {"a": {"b": (1, 2)}}])
def test_equal_values_do_not_differ(value):
    assert found(value, value) == []


@pytest.mark.parametrize(
    ("recorded", "again", "difference"),
    [
        (1, 2, "run: 1 recorded, 2 found"),
        (20.0, 20.0 * (1 + 1e-8), "run: 20.0 recorded, 20.0000002 found"),
        ({"a": 1}, {}, "run.a: should not be there"),
        ({}, {"a": 1}, "run.a: missing"),
        ({"a": [1, 2]}, {"a": [1, 3]}, "run.a[1]: 2 recorded, 3 found"),
        ([1], [1, 2], "run: 1 entries recorded, 2 found"),
    ],
)
def test_each_difference_is_placed_and_told(recorded, again, difference):
    assert found(recorded, again) == [difference]


def test_estimates_may_differ_by_rounding():
    assert found({"low": 20.0}, {"low": 20.0 * (1 + 1e-10)}) == []
    assert found({"low": 0.0}, {"low": 1e-17}) == []


def test_a_check_that_could_not_be_made_is_no_failed_one():
    problems = Problems()
    with problems.caught("run.json"):
        raise UnreadableFileError("it cannot be read: Permission denied")
    assert [problem.is_unchecked for problem in problems] == [True]
    with pytest.raises(InfrastructureError), problems.caught("run.json"):
        raise InfrastructureError("a worker died")
