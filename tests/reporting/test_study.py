import pandas as pd

from minitouch_bench.reporting.study import paper_orders


def estimates(**values):
    """Return one task's estimates of three seeds; a name is ``method__metric``."""
    rows = [
        ("pushing", name.split("__")[0].replace("_", "-"), seed, 6000, "table4", metric, value)
        for name, own in values.items()
        for metric in (name.split("__")[1],)
        for seed, value in enumerate(own)
    ]
    names = ["task", "method", "seed", "exploration_steps", "suite", "metric", "value"]
    return pd.DataFrame(rows, columns=names)


def test_the_papers_order_is_judged_for_exploration_and_for_success():
    table = estimates(
        hac__exploration=(0.3, 0.4, 0.5),
        rnd_touch__exploration=(0.1, 0.2, 0.1),
        rnd__exploration=(0.6, 0.7, 0.8),
        hac__success=(0.5, 0.1, 0.3),
        rnd_touch__success=(0.4, 0.2, 0.3),
    )
    lines = list(paper_orders(table))
    start = "Pushing, 6,000 steps of exploration: "
    assert lines == [
        f"{start}hac > rnd-touch in exploration holds (0.400 against 0.133, p = 0.050)",
        f"{start}rnd-touch > rnd in exploration does not hold (0.133 against 0.700, p = 0.050)",
        f"{start}hac > rnd-touch in success cannot be told "
        "(0.300 against 0.300, p = 0.600, 3 and 3 seeds)",
    ]


def test_one_seed_tells_nothing_about_an_order():
    table = estimates(hac__success=(0.9,), rnd_touch__success=(0.1,))
    (line,) = paper_orders(table)
    assert line.endswith("cannot be told (0.900 against 0.100, 1 and 1 seeds)")
