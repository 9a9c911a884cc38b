from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.reporting.charts import Bar, Dot
from minitouch_bench.reporting.figures import report_figures, split_figures, steps_plot, touch_plot
from minitouch_bench.reporting.labels import describe_runs, tasks_in_order
from minitouch_bench.runs.actions import ForceStep


def parts(*runs):
    return describe_runs(runs), tasks_in_order(runs)


def bars(chart):
    return [mark for mark in chart.marks if isinstance(mark, Bar)]


def test_histograms_stack_to_100_percent_on_one_axis():
    panels = {
        "a": {"success": np.array([3, 3, 12]), "limit": np.array([200])},
        "b": {"success": np.array([], int), "limit": np.array([200, 200])},
    }
    first, second = steps_plot("pushing", panels).charts
    assert first.y == second.y
    assert first.y.high >= 100
    assert sum(bar.top - bar.bottom for bar in bars(first)) == pytest.approx(100)
    assert [bar.tone for bar in bars(first)] == ["success", "success", "limit"]
    # An episode at the limit has a bar of its own behind 190-199.
    assert bars(first)[-1].left > 200


@pytest.mark.parametrize(("steps", "behind"), [([3, 2**62], [False, True]), ([], [])])
def test_what_a_file_says_beyond_the_limit_takes_no_memory(steps, behind):
    (chart,) = steps_plot("pushing", {"": {"success": np.array(steps, int)}}).charts
    assert [bar.left > 200 for bar in chart.marks] == behind


@pytest.mark.parametrize("reached", [(100, 50, 9, 1), ()])
def test_a_touch_curve_is_faint_where_few_episodes_are_left(hac, reached):
    tasks = (
        replace(one, touch_curve=(1.0, 2.0, 3.0, 4.0), touch_curve_episodes=reached)
        for one in hac.summary.tasks
    )
    run = replace(hac, summary=replace(hac.summary, tasks=tuple(tasks)))
    certain, *faint = touch_plot("pushing", [run]).charts[0].marks
    assert certain.points == ((0, 1.0), (1, 2.0), (2, 3.0), (3, 4.0))[: 2 if reached else 4]
    assert [line.points[0] for line in faint] == ([certain.points[-1]] if reached else [])
    assert all(line.opacity < certain.opacity for line in faint)


def test_the_figures_name_their_units_and_the_paper_is_never_on_an_axis_of_touch(hac):
    forces = {"pushing": [ForceStep(20, 0.98, 1.0, 7.5), ForceStep(1, 2.0, 2.0, 2.0)]}
    figures = report_figures(*parts(hac), [forces])
    axes = [figure.plots[0].charts[0] for figure in figures]
    assert [(chart.x.label, chart.y.label) for chart in axes] == [
        ("Success, share of episodes", ""),
        ("Control steps", "Episodes, %"),
        ("Control steps", "Ticks per step"),
        ("Control steps", "Force, N"),
    ]
    assert [item.text for item in figures[1].legend][-1] == "policy fault"
    assert "never touched by a finger" not in [item.text for item in figures[1].legend]
    rows = {plot.caption: [t.text for t in plot.charts[0].y.ticks] for plot in figures[0].plots}
    assert rows["Pushing"] == ["hac-seed1", "HaC", "RND+touch", "RND"]
    assert rows["Playing"] == ["hac-seed1"]
    assert figures[2].legend == ()  # one run


def test_forces_are_a_band_around_a_line_and_faint_where_few_episodes_are_left(hac, scripted):
    steps = [ForceStep(n, 1.0 * i, 2.0 * i, 3.0 * i) for i, n in enumerate((20, 18, 1))]
    forces = report_figures(*parts(hac, scripted), [{"pushing": steps}, {}])[-1]
    band, line, faint_band, faint_line = forces.plots[0].charts[0].marks
    assert band.points == ((0, 0.0), (1, 1.0), (1, 3.0), (0, 0.0))
    assert line.points == ((0, 0.0), (1, 2.0))
    assert faint_line.points == ((1, 2.0), (2, 4.0))
    assert faint_band.opacity < band.opacity
    assert "--forces" in forces.text
    nothing = report_figures(*parts(hac), [{}])[-1]
    assert (nothing.plots, nothing.legend) == ((), ())


def test_every_run_has_a_panel_of_its_own(hac, scripted):
    steps = report_figures(*parts(hac, scripted), [{}, {}])[1].plots[0]
    assert [chart.title for chart in steps.charts] == ["hac-seed1", "scripted"]
    total = [sum(bar.top - bar.bottom for bar in bars(chart)) for chart in steps.charts]
    assert total == pytest.approx([100, 100])


def test_the_splits_have_a_plot_per_task_and_metric_with_marks_where_the_estimates_are(novel, hac):
    assert split_figures(*parts(hac)) == ()
    (pairs,) = split_figures(*parts(novel, hac))
    assert [plot.caption for plot in pairs.plots][::2] == [
        "Pushing: success",
        "Pick-up: success",
        "Playing: touch share",
    ]
    assert pairs.plots[1].charts[0].x.label == "Episode steps, control steps"
    assert len(pairs.legend) == 4
    gap = next(r for r in novel.summary.generalization if r.task == "pushing").gaps["success"]
    dots = [mark for mark in pairs.plots[0].charts[0].marks if isinstance(mark, Dot)]
    assert [(dot.x, dot.is_hollow) for dot in dots] == [
        (gap.held_out.value, False),
        (gap.train.value, True),
    ]
