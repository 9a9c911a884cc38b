from minitouch_bench.errors import UsageError
from minitouch_bench.verification.problems import Problem, Problems


def test_a_problem_says_where_what_and_what_to_do():
    assert str(Problem("a/b", "it is missing")) == "a/b: it is missing"
    assert str(Problem("a/b", "it is missing", "add it")) == "a/b: it is missing; add it"


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
    problems.add_below("c", Problem("d", "also wrong"))
    assert [str(problem) for problem in problems] == [
        "a: wrong; correct it",
        "b: two lines",
        "c, d: also wrong",
    ]
