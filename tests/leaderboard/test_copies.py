"""What exact comparison finds of runs that share episodes, and what it cannot find."""

from types import SimpleNamespace

from minitouch_bench.leaderboard.validation import find_copies


def episodes(name, changed=0, number=400, steps=30):
    """Return a run whose first ``changed`` episodes are played in another way."""
    digests = [f"{name}{' otherwise' if i < changed else ''}" for i in range(number)]
    return SimpleNamespace(
        rows=[
            SimpleNamespace(task="pushing", index=i, digest=one, steps=steps)
            for i, one in enumerate(digests)
        ]
    )


def test_runs_of_other_trainings_and_episodes_without_a_step_share_nothing():
    assert find_copies({"a": episodes("a"), "b": episodes("b"), "c": episodes("c", number=0)}) == {}
    assert find_copies({"a": episodes("a", steps=0), "b": episodes("a", steps=0)}) == {}


def test_every_pair_is_compared_and_the_earlier_run_is_named_first():
    runs = {"a": episodes("a"), "b": episodes("b"), "c": episodes("b"), "d": episodes("b", 1)}
    assert find_copies(runs) == {("b", "c"): 400, ("b", "d"): 399, ("c", "d"): 399}


def test_half_of_the_smaller_run_is_enough():
    """A copy with noise or a gain of 0.9 is not seen: see docs/explanation/levels-of-proof.md."""
    for other, shared in (
        (episodes("a", 200), {("a", "b"): 200}),
        (episodes("a", 201), {}),
        (episodes("a", 400), {}),
        (episodes("a", number=10), {("a", "b"): 10}),
    ):
        assert find_copies({"a": episodes("a"), "b": other}) == shared


def test_a_row_that_is_repeated_counts_once():
    many = SimpleNamespace(rows=episodes("a", number=1).rows * 5000)
    assert find_copies({"a": many, "b": many}) == {}  # one of 5,000 rows is shared
