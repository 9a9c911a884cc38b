import re
from dataclasses import replace

import pytest

from minitouch_bench.episode import Outcome
from minitouch_bench.errors import UsageError
from minitouch_bench.perturbation import Perturbation
from minitouch_bench.reporting.endings import Ending, ending_of
from minitouch_bench.reporting.figures import check_figure, report_figures, steps_plot, write_figure
from minitouch_bench.reporting.labels import MARK, PAPER_METHODS, describe_runs, tasks_in_order
from minitouch_bench.reporting.report import TABLE_FORMATS, build_report, to_html
from tests.reporting.synthetic import make_run, save


def test_histograms_stack_to_100_percent_on_one_axis(hac):
    def ended(outcome, *steps):
        return [replace(hac.rows[0], task="pushing", outcome=outcome, steps=one) for one in steps]

    limit = ended(Outcome.POLICY_FAULT, 200)
    panels = {"a": [*ended(Outcome.SUCCESS, 3, 3, 12), *limit], "b": limit * 2}
    first, second = steps_plot("pushing", panels).charts
    assert first.y == second.y
    assert first.y.high >= 100
    bars = [(mark.tone, *box) for mark in first.marks for box in mark.boxes]
    assert sum(top - bottom for _, _, bottom, _, top in bars) == pytest.approx(100)
    assert [tone for tone, *_ in bars] == ["success", "success", "fault"]
    assert bars[-1][1] > 200  # a bar of its own behind 190-199


def test_true_forces_are_told_from_those_that_a_policy_was_given(hac):
    plan = replace(hac.plan, conditions=Perturbation(without=("forces",)))
    numb = replace(hac, header=replace(hac.header, plan=plan))
    figures = [report_figures(describe_runs([run]), tasks_in_order([run])) for run in (hac, numb)]
    texts = [one.text for found in figures for one in found if one.key == "forces"]
    assert ["given others: hac-seed1" in text for text in texts] == [False, True]


def test_a_run_whose_numbers_contradict_each_other_is_drawn_without_them(hac):
    tasks = [replace(task, force_curve=(), touch_curve=()) for task in hac.summary.tasks]
    untouched = [replace(row, touch_interaction=0.0, peak_force=9.0) for row in hac.rows]
    assert {ending_of(row) for row in untouched} >= {Ending.NEVER_TOUCHED}
    edited = replace(hac, summary=replace(hac.summary, tasks=tuple(tasks)), rows=tuple(untouched))
    figures = report_figures(describe_runs([edited]), tasks_in_order([edited]))
    assert {one.key for one in figures} >= {"episode-steps"}


# A figure for a paper, drawn by the real matplotlib; and a report without the paper's values


@pytest.fixture(scope="module")
def runs():
    return [save(make_run(name, skill=skill)) for name, skill in (("ours", 0.8), ("x$y$_1", 0.3))]


@pytest.mark.parametrize(
    ("suffix", "magic"), [(".svg", b"<?xml"), (".pdf", b"%PDF"), (".png", b"\x89PNG")]
)
def test_each_kind_is_written_and_is_the_same_again(runs, tmp_path, suffix, magic):
    report = build_report(runs)
    contents = []
    for name in ("one", "again"):
        path = tmp_path / f"{name}{suffix}"
        write_figure(report.sections, report.tasks, (), path)
        contents.append(path.read_bytes())
    assert contents[0] == contents[1]
    assert contents[0].startswith(magic)


def test_runs_are_grouped_by_task_and_named_as_they_are(runs, tmp_path):
    path = tmp_path / "figure.svg"
    report = build_report(runs)
    write_figure(report.sections, report.tasks, (), path)
    text = path.read_text()
    assert [text.count(f">{task}<") for task in ("Pushing", "Opening", "Pick-up", "Playing")] == [
        1, 1, 1, 1,
    ]  # fmt: skip
    assert "Success (share of episodes)" in text
    assert "Touch share" in text
    assert ">x$y$_1<" in text
    write_figure(report.sections, report.tasks, ("object_movement",), path)
    assert {"Object movement (m²)", "Object movement (rad²)"} <= {
        *re.findall(">(.*)<", path.read_text())
    }
    write_figure(report.sections, report.tasks, ("exploration",), path)
    assert "Playing" not in path.read_text()


def test_what_cannot_be_drawn_is_refused(runs, tmp_path):
    with pytest.raises(UsageError, match=r"\.svg, \.pdf, \.png"):
        check_figure(tmp_path / "figure.jpg")
    with pytest.raises(UsageError, match="nothing to draw"):
        write_figure(describe_runs(runs), ("playing",), ("exploration",), tmp_path / "figure.svg")


def test_without_the_paper_no_form_has_its_values(runs):
    report = build_report(runs, with_paper=False)
    for text in (to_html(report), *(write(report) for write in TABLE_FORMATS.values())):
        assert MARK not in text
        assert "in the paper" not in text
        assert all(f"{method}," not in text for method in PAPER_METHODS)


def test_a_task_without_rows_has_no_heading_and_a_mark_has_its_note(runs):
    of_success = TABLE_FORMATS["md"](build_report(runs, metrics=("success",)))
    assert "Playing" not in of_success
    assert MARK not in of_success
    of_touch = TABLE_FORMATS["md"](build_report(runs, metrics=("touch_interaction",)))
    assert f"{MARK} other unit" in of_touch
