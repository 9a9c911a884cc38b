from dataclasses import replace

import pytest

from minitouch_bench.metrics.definitions import DOWN, NO_DIRECTION, UP
from minitouch_bench.metrics.intervals import Estimate
from minitouch_bench.reporting.report import build_report
from minitouch_bench.reporting.report_tables import gap_in_words, mark_best
from minitouch_bench.reporting.tables import ABSENT, Cell


def row(table, label):
    return next(row for row in table.rows if row.heads[0].startswith(label))


def test_table4_has_a_column_per_run_and_the_paper_s_values(hac, scripted):
    both = build_report([hac, scripted]).table4
    assert both.groups[0] == ("Pushing", 5)
    success = row(both, "Success").cells
    assert success[0].small.startswith("[")
    assert [cell.text for cell in success[1:5]] == ["1.000", "0.733", "0.710", "0.582"]
    alone = build_report([scripted]).table4  # it was not run on Opening, and has not explored
    assert {cell.text for cell in row(alone, "Success").cells[4:]} == {success[6].text} == {ABSENT}
    assert row(alone, "Exploration").cells[0].text == ABSENT


def test_a_metric_of_several_units_has_them_in_its_cells(hac):
    (moved,) = build_report([hac], metrics=["object_movement"]).table4.rows
    assert moved.unit == ""
    assert [cell.text.split(" ")[1] for cell in moved.cells if cell.text != ABSENT] == [
        "m²", "rad²", "m²", "m²",
    ]  # fmt: skip


def test_the_best_of_several_runs_is_bold_on_pages_and_the_caption_says_what_that_is():
    cells = [Cell("0.500", sort_key=0.5), Cell(), Cell("0.250", sort_key=0.25)]
    best = [[cell.is_best for cell in mark_best(cells, way)] for way in (UP, DOWN, NO_DIRECTION)]
    assert best == [[True, False, False], [False, False, True], [False] * 3]
    assert not any(cell.is_best for cell in mark_best(cells[:2], UP))
    assert not any(cell.is_best for cell in mark_best([cells[0]] * 2, UP))


def test_labels_stand_below_every_table_and_mark_a_run(hac, scripted):
    report = build_report([hac, scripted])
    for table in (report.table4, report.diagnostics):
        notes = "\n".join(table.notes)
        assert "* scripted: reads the simulator's state; unofficial: 5 of 100 episodes." in notes
        assert "* hac-seed1: 2 policy faults: act() gave NaN" in notes
    assert report.table4.columns[0].label == "hac-seed1\u00a0*"
    assert build_report([replace(hac, faults={})]).table4.columns[0].label == "hac-seed1"
    assert "one training seed" in "\n".join(report.table4.notes)


@pytest.mark.parametrize(
    ("task", "metric", "low", "high", "words"),
    [
        ("pushing", "touch_interaction", 1.0, 2.0, "more on held-out"),
        ("playing", "touch_interaction", 1.0, 2.0, "better on held-out"),
        ("pushing", "success", -0.1, 0.0, "no difference seen"),
        ("pushing", "episode_steps", 1.0, 2.0, "worse on held-out"),
        ("pushing", "object_movement", -2e-4, -1e-4, "less on held-out"),
    ],
)
def test_the_verdict_says_what_the_interval_says(task, metric, low, high, words):
    estimate = Estimate((low + high) / 2, low, high, 40, "bootstrap")
    assert gap_in_words(task, metric, estimate) == words
