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


def test_each_difference_is_placed_and_told():
    assert found({"a": [1, 2]}, {"a": [1, 3]}) == ["run.a[1]: 2 recorded, 3 found"]
    assert found({"a": 1}, {}) == ["run.a: should not be there"]


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
