import pytest

from minitouch_bench.reporting.labels import PAPER_METHODS, PAPER_TASKS, paper_value


def test_tasks_and_methods_stand_in_the_order_of_the_paper():
    assert PAPER_TASKS == ("pushing", "opening", "pick-up", "playing")
    assert PAPER_METHODS == ("HaC", "RND+touch", "RND")


@pytest.mark.parametrize(
    ("task", "metric", "printed"),
    [
        ("pushing", "exploration", ("0.403", "0.181", "0.077")),
        ("opening", "exploration", ("0.669", "0.564", "0.380")),
        ("pick-up", "exploration", ("0.063", "0.013", "0.005")),
        ("pushing", "success", ("0.733", "0.710", "0.582")),
        ("opening", "success", ("0.983", "0.921", "0.875")),
        ("pick-up", "success", ("0.891", "0.593", "0.450")),
        ("pushing", "episode_steps", ("57.84", "55.20", "97.51")),
        ("opening", "episode_steps", ("23.34", "23.54", "37.92")),
        ("pick-up", "episode_steps", ("30.54", "52.29", "89.88")),
        ("pushing", "touch_interaction", ("247.79", "227.75", "206.02")),
        ("opening", "touch_interaction", ("600.1", "411.43", "194.22")),
        ("pick-up", "touch_interaction", ("980.7", "894.5", "725.1")),
        ("playing", "touch_interaction", ("388.15", "312.0", "124.5")),
    ],
)
def test_figures_are_those_of_table_4(task, metric, printed):
    values = [paper_value(task, metric, method) for method in PAPER_METHODS]
    assert tuple(value.text for value in values) == printed


def test_a_figure_the_paper_does_not_give_is_none():
    assert paper_value("playing", "success", "HaC") is None


def test_ticks_of_touch_are_in_no_unit_of_ours():
    touch = paper_value("playing", "touch_interaction", "HaC")
    assert (touch.number, touch.remark) == (None, "other unit")
    success = paper_value("pushing", "success", "HaC")
    assert (success.number, success.remark) == (0.733, "")
