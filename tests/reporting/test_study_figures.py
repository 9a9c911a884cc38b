"""What a study's figures show of its two tables."""

from itertools import product

import pandas as pd
import pytest

from minitouch_bench.metrics.intervals import wilson
from minitouch_bench.rendering.charts import Band, Dot, Line
from minitouch_bench.rendering.figure_files import write_figures
from minitouch_bench.reporting.long_frame import GAP, estimates_in, join_seeds
from minitouch_bench.reporting.study_figures import POINTS, learning_curves, study_figures
from minitouch_bench.reporting.study_tables import study_tables

METHODS = ("hac", "rnd")


def row(training, metric, value, suite="table4"):
    task, method, seed, steps = training
    return {
        "task": task, "method": method, "seed": seed, "steps": steps, "suite": suite,
        "conditions": "", "metric": metric, "value": value, "low": value - 0.1,
        "high": value + 0.1, "count": 100,
        "interval": "wilson" if metric.startswith("success") else "bootstrap",
    }  # fmt: skip


def curves(lengths):
    return pd.DataFrame(
        {
            "task": "opening", "method": method, "seed": seed, "steps": steps,
            "step": step, "touch_share": 0.5, "success": step / 1000,
        }
        for method, seed, steps, step in product(METHODS, (0, 1), lengths, (100, 200, 300))
    )  # fmt: skip


def estimates(lengths):
    metrics = {
        "success": 0.8, "episode_steps": 20.0, "touch_share": 0.4, "object_movement": 0.02,
        "touch_share, exploring": 0.9, "object_movement, exploring": 0.001,
    }  # fmt: skip
    main = [
        row(("opening", method, seed, steps), metric, value + seed / 10)
        for method, seed, steps in product(METHODS, (0, 1), lengths)
        for metric, value in metrics.items()
    ]
    novel = [
        row(("pushing", method, 0, lengths[0]), f"success, {split}", value, "novel-shapes")
        for method, (split, value) in product(METHODS, (("train", 0.6), ("held-out", 0.5)))
    ]
    return pd.DataFrame(main + novel)


@pytest.fixture(scope="module")
def figures():
    lengths = (1000, 2000)
    return {figure.key: figure for figure in study_figures(estimates(lengths), curves(lengths))}


def marks(figure, kind):
    found = [mark for plot in figure.plots for chart in plot.charts for mark in chart.marks]
    return [mark for mark in found if isinstance(mark, kind)]


def test_there_is_a_figure_for_each_question(figures):
    assert [*figures] == ["curves", "movement", "lengths", "novel-shapes"]


def test_a_mean_ends_where_the_first_seed_does():
    frame = curves((1000,))
    frame = frame[(frame["seed"] == 0) | (frame["step"] < 300)]  # seed 1 was broken off
    figure = learning_curves(frame)
    assert {line.points[-1][0] for line in marks(figure, Line)} == {200.0}


def test_a_curve_is_a_mean_over_seeds_with_its_interval():
    frame = pd.DataFrame(
        {
            "task": "opening", "method": "hac", "seed": seed, "steps": 1000,
            "step": step, "touch_share": 0.5, "success": success,
        }
        for step in (100, 200)
        for seed, success in enumerate((0.0, 0.4, 0.4, 0.4, 1.0))
    )  # fmt: skip
    figure = learning_curves(frame)
    (line,), (band,) = marks(figure, Line), marks(figure, Band)
    assert dict(line.points) == {100.0: pytest.approx(0.44), 200.0: pytest.approx(0.44)}
    low, high = dict(band.low)[100.0], dict(band.high)[100.0]
    assert 0.0 < low < 0.44 < high < 1.0
    figure = learning_curves(frame[frame["seed"] == 0])
    assert len(marks(figure, Line)) == 1
    assert not marks(figure, Band)


def test_a_point_of_a_long_curve_is_a_mean_over_several_rows():
    steps = range(1, 401)
    frame = pd.DataFrame({"step": steps, "success": [step % 2 for step in steps]})
    frame = frame.assign(task="opening", method="hac", seed=0, steps=400, touch_share=0.0)
    figure = learning_curves(frame)
    (line,) = marks(figure, Line)
    assert line.points == tuple((10.0 * (point + 1), 0.5) for point in range(POINTS))


def test_movement_is_shown_as_of_the_end_of_exploration(figures):
    dots = marks(figures["movement"], Dot)
    assert len(dots) == 2 * 2 * 2
    assert {(dot.x, dot.y) for dot in dots} == {(0.9, 0.001), (1.0, 0.101)}


def test_each_length_of_exploration_is_a_mean_over_seeds_with_its_interval(figures):
    (plot,) = figures["lengths"].plots
    success, steps = plot.charts
    assert [(dot.x, dot.y) for dot in success.marks if isinstance(dot, Dot)] == [
        (1000.0, pytest.approx(0.85)),
        (2000.0, pytest.approx(0.85)),
    ] * 2
    assert steps.y.label == "Episode steps"
    intervals = [one for one in success.marks if isinstance(one, Line) and one.width == 2.2]
    assert len(intervals) == 4
    assert all(low[1] < 0.85 < high[1] for low, high in (one.points for one in intervals))


def test_held_out_shapes_stand_beside_train_shapes(figures):
    dots = marks(figures["novel-shapes"], Dot)
    assert {(dot.x, dot.is_hollow) for dot in dots} == {(0.6, True), (0.5, False)}


def test_each_condition_has_a_row_with_the_methods_that_played_under_it():
    main = estimates((1000,))
    changed = main[(main["metric"] == "success") & (main["method"] == "hac")]
    changed = changed.assign(conditions="mass 0.5 to 2 times", value=0.2, low=0.1, high=0.3)
    both = pd.concat([main, changed])
    figure = {one.key: one for one in study_figures(both, curves((1000,)))}["conditions"]
    (plot,) = figure.plots
    rows = plot.charts[0].y.ticks
    assert [tick.text for tick in rows] == ["standard", "mass 0.5 to 2"]
    assert [(dot.x, dot.y) for dot in marks(figure, Dot)] == [(pytest.approx(0.85), 0), (0.2, 1)]
    assert [item.text for item in figure.legend] == ["hac"]


def test_one_length_and_one_suite_give_no_empty_figures():
    main = estimates((1000,))
    main = main[main["suite"] == "table4"]
    assert [one.key for one in study_figures(main, curves((1000,)))] == ["curves", "movement"]
    nothing = (main.iloc[:0], curves((1000,)).iloc[:0])
    assert study_figures(*nothing) == ()


def test_they_can_be_drawn(figures, tmp_path):
    for path in write_figures(tuple(figures.values()), tmp_path):
        assert path.stat().st_size > 1000


def joined(metric, *values):
    rows = pd.DataFrame(
        row(("pushing", "hac", seed, 1), metric, value) for seed, value in enumerate(values)
    )
    rows["count"] = 25
    if metric.endswith(GAP):
        rows["interval"] = "newcombe"
    (estimate,) = estimates_in(join_seeds(rows))
    return estimate


@pytest.mark.parametrize(
    ("metric", "value", "interval"),
    [("success", 1.0, (wilson(75, 75).low, 1.0)), ("touch_share", 0.5, (0.442, 0.558))],
)
def test_seeds_that_agree_are_no_proof(metric, value, interval):
    found = joined(metric, value, value, value)
    assert found.value == value
    assert (found.low, found.high) == pytest.approx(interval, abs=5e-4)


def test_a_gap_of_shares_is_no_share():
    found = joined(f"success{GAP}", -0.1, -0.05, 0.0)
    assert found.low < found.value < found.high
    # No narrower than over the seeds, which lie between these.
    assert found.low <= -0.1
    assert found.high >= 0.0


def test_tables_have_a_row_per_metric_that_a_method_has_and_the_paper_beside_ours():
    first, second, _seeds = study_tables(estimates((1000, 2000)))
    assert first.title == "Table 4, exploration 1 of 2"
    assert second.title == "Table 4, exploration 2 of 2"
    assert first.notes[0] == "Control steps of exploration: Opening 1,000."
    assert [column.label for column in first.columns] == [*METHODS, "HaC", "RND+touch", "RND"]
    success = next(row for row in first.rows if row.heads == ("Success ↑",))
    assert str(success.cells[0]).startswith("0.850 [")
    assert second.notes[0] == "Control steps of exploration: Opening 2,000."


def test_each_training_seed_has_its_value_or_a_dash():
    frame = pd.concat([estimates((1000,)), estimates((2000,)).assign(task="playing")])
    frame = frame[(frame["method"] == "hac") | (frame["seed"] == 0)]
    *_, table = study_tables(frame)
    assert table.title == "Training seeds"
    assert {row.heads: [str(cell) for cell in row.cells] for row in table.rows} == {
        ("Success", "Opening", "hac", "1,000"): ["0.800 [0.700, 0.900]", "0.900 [0.800, 1.000]"],
        ("Success", "Opening", "rnd", "1,000"): ["0.800 [0.700, 0.900]", "—"],
        ("Touch share", "Playing", "hac", "2,000"): [
            "0.400 [0.300, 0.500]",
            "0.500 [0.400, 0.600]",
        ],
        ("Touch share", "Playing", "rnd", "2,000"): ["0.400 [0.300, 0.500]", "—"],
    }


def test_without_a_run_of_table_4_there_is_no_table_of_its_seeds():
    frame = estimates((1000,))
    assert [*study_tables(frame.iloc[:0])] == []
    assert [*study_tables(frame[frame["suite"] == "novel-shapes"])] == []


def test_other_conditions_stand_beside_the_standard_ones():
    others = estimates((1000,))
    others = others[others["suite"] == "table4"].assign(conditions="without forces")
    others["value"] /= 2
    *_, table = study_tables(pd.concat([estimates((1000, 2000)), others]))
    assert table.title == "Other conditions"
    # The longest exploration is shown, and what there is of it.
    assert [row.heads for row in table.rows] == [("Opening", "standard", "Success")]
    *_, table = study_tables(pd.concat([estimates((1000,)), others]))
    assert [row.heads[1] for row in table.rows] == ["standard", "without forces"]
    assert [cell.text for row in table.rows for cell in row.cells] == ["0.850"] * 2 + ["0.425"] * 2


def test_tasks_with_their_own_length_stand_in_one_table():
    frame = pd.concat([estimates((1000,)), estimates((2000,)).assign(task="pushing")])
    table, _seeds = study_tables(frame[frame["suite"] == "table4"])
    assert table.title == "Table 4"
    assert table.notes[0] == "Control steps of exploration: Opening 1,000, Pushing 2,000."
    assert "lengths" not in [one.key for one in study_figures(frame, curves((1000,)))]
