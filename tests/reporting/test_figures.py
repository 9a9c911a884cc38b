from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.perturbation import Perturbation
from minitouch_bench.reporting.charts import Band
from minitouch_bench.reporting.figures import report_figures, steps_plot
from minitouch_bench.reporting.labels import describe_runs, tasks_in_order


def parts(*runs):
    return describe_runs(runs), tasks_in_order(runs)


def bars(chart):
    return [mark for mark in chart.marks if isinstance(mark, Band)]


def height(bar):
    (_, bottom), (_, top), *_ = bar.points
    return top - bottom


def test_histograms_stack_to_100_percent_on_one_axis():
    panels = {
        "a": {"success": np.array([3, 3, 12]), "limit": np.array([200])},
        "b": {"success": np.array([], int), "limit": np.array([200, 200])},
    }
    first, second = steps_plot("pushing", panels).charts
    assert first.y == second.y
    assert first.y.high >= 100
    assert sum(height(bar) for bar in bars(first)) == pytest.approx(100)
    assert [bar.tone for bar in bars(first)] == ["success", "success", "limit"]
    # An episode at the limit has a bar of its own behind 190-199.
    assert bars(first)[-1].points[0][0] > 200


def test_the_paper_is_never_on_an_axis_of_touch(hac):
    first, *_ = report_figures(*parts(hac))
    rows = {plot.caption: [t.text for t in plot.charts[0].y.ticks] for plot in first.plots}
    assert rows["Pushing"] == ["hac-seed1", "HaC", "RND+touch", "RND"]
    assert rows["Playing"] == ["hac-seed1"]


def test_true_forces_are_told_from_those_that_a_policy_was_given(hac):
    plan = replace(hac.plan, conditions=Perturbation(without=("forces",)))
    numb = replace(hac, header=replace(hac.header, plan=plan))
    figures = [{one.key: one for one in report_figures(*parts(run))} for run in (hac, numb)]
    texts = [found["forces"].text for found in figures]
    assert ["given others: hac-seed1" in text for text in texts] == [False, True]
