from minitouch_bench.verification.static_check import Problem, compare_values


def test_what_a_stranger_wrote_reaches_no_terminal_and_stays_short():
    text = str(Problem("\x1b[31m", "\x1b[2J\n" + "x" * 10_000))
    assert text.isprintable()
    assert len(text) < 500


def found(recorded, again):
    return [str(difference) for difference in compare_values("run", recorded, again)]


def test_each_difference_is_placed_and_told():
    assert found({"a": [1, 2]}, {"a": [1, 3]}) == ["run.a[1]: 2 recorded, 3 found"]
    assert found({"a": 1}, {}) == ["run.a: should not be there"]


def test_estimates_may_differ_by_rounding():
    assert found({"low": 20.0}, {"low": 20.0 * (1 + 1e-10)}) == []
    assert found({"low": 0.0}, {"low": 1e-17}) == []
