from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.reporting.charts import Bar
from minitouch_bench.reporting.figures import steps_plot, touch_plot


def test_histograms_stack_to_100_percent_on_one_axis():
    panels = {
        "a": {"success": np.array([3, 3, 12]), "limit": np.array([200])},
        "b": {"success": np.array([], int), "limit": np.array([200, 200])},
    }
    first, second = steps_plot("pushing", panels).charts
    assert first.y == second.y
    assert first.y.high >= 100
    bars = [mark for mark in first.marks if isinstance(mark, Bar)]
    assert sum(bar.top - bar.bottom for bar in bars) == pytest.approx(100)
    assert [bar.tone for bar in bars] == ["success", "success", "limit"]
    # An episode at the limit has a bar of its own behind 190-199.
    assert bars[-1].left > 200


def test_what_a_file_says_beyond_the_limit_takes_no_memory():
    (chart,) = steps_plot("pushing", {"": {"success": np.array([3, 2**62])}}).charts
    assert [bar.left > 200 for bar in chart.marks] == [False, True]


def test_no_episodes_give_no_bars():
    (chart,) = steps_plot("pushing", {"": {"success": np.array([], int)}}).charts
    assert chart.marks == ()


def with_curve(run, curve, reached):
    tasks = (
        replace(task, touch_curve=curve, touch_curve_episodes=reached) for task in run.summary.tasks
    )
    return replace(run, summary=replace(run.summary, tasks=tuple(tasks)))


def test_a_touch_curve_is_faint_where_few_episodes_are_left(hac):
    run = with_curve(hac, (1.0, 2.0, 3.0, 4.0), (100, 50, 9, 1))
    certain, faint = touch_plot("pushing", [run]).charts[0].marks
    assert certain.points == ((0, 1.0), (1, 2.0))
    assert faint.points[0] == certain.points[-1]
    assert faint.opacity < certain.opacity
