from dataclasses import replace

from minitouch_bench.metrics.intervals import Estimate
from minitouch_bench.reporting.labels import estimate_cell
from minitouch_bench.reporting.report import build_report
from minitouch_bench.reporting.tables import ABSENT


def row(table, label):
    return next(row for row in table.rows if row.heads[0].startswith(label))


def test_table4_has_the_shape_of_the_paper(hac):
    table = build_report([hac]).table4
    assert [head for row in table.rows for head in row.heads] == [
        "Exploration ↑",
        "Success ↑",
        "Episode steps ↓",
        "Touch-interaction (↑ in playing)",
        "Touch share (↑ in playing)",
    ]
    assert table.groups == (("Pushing", 4), ("Opening", 4), ("Pick-up", 4), ("Playing", 4))
    assert [column.is_paper for column in table.columns[:4]] == [False, True, True, True]
    assert [column.label for column in table.columns[1:4]] == ["HaC", "RND+touch", "RND"]


def test_a_run_has_a_column_in_every_block(hac, scripted):
    table = build_report([hac, scripted]).table4
    assert table.groups[0] == ("Pushing", 5)
    success = row(table, "Success").cells
    assert success[0].small.startswith("[")
    assert success[1].text == "1.000"
    assert [cell.text for cell in success[2:5]] == ["0.733", "0.710", "0.582"]
    # scripted was not run on Opening
    assert success[6].text == ABSENT


def test_what_does_not_exist_is_a_dash_never_a_zero(scripted):
    table = build_report([scripted]).table4
    assert row(table, "Exploration").cells[0].text == ABSENT
    playing = [cell.text for cell in row(table, "Success").cells[4:]]
    assert playing == [ABSENT] * 4


def test_only_tasks_that_were_run_are_shown(scripted):
    assert [group for group, _ in build_report([scripted]).table4.groups] == [
        "Pushing",
        "Playing",
    ]


def test_figures_carry_their_interval():
    cell = estimate_cell("success", Estimate(0.97, 0.9155, 0.9897, 100, "wilson"))
    assert str(cell) == "0.970 [0.915, 0.990]" or str(cell) == "0.970 [0.916, 0.990]"
    assert "100 episodes" in cell.title


def test_labels_stand_below_every_table(hac, scripted):
    report = build_report([hac, scripted])
    for table in (report.table4, report.diagnostics):
        notes = "\n".join(table.notes)
        assert "* scripted: reads the simulator's state; unofficial: 5 of 100 episodes." in notes
        assert "* hac-seed1: 2 policy faults." in notes


def test_table4_says_what_its_intervals_mean_and_whose_the_paper_is(hac):
    notes = "\n".join(build_report([hac]).table4.notes)
    assert "episode variance only (one training seed)" in notes
    assert "the paper's own values, other episodes and object sets" in notes


def test_a_clean_official_run_has_no_mark(hac):
    clean = replace(hac, faults={})
    assert build_report([clean]).table4.columns[0].label == "hac-seed1"
    assert build_report([hac]).table4.columns[0].label == "hac-seed1\u00a0*"


def test_diagnostics_have_a_row_a_task_and_run(hac, scripted):
    table = build_report([hac, scripted]).diagnostics
    heads = [row.heads for row in table.rows]
    assert len(heads) == 6
    assert heads[0] == ("Pushing", "hac-seed1\u00a0*")
    cells = dict(zip([column.label for column in table.columns], table.rows[0].cells, strict=True))
    assert cells["Policy faults"].text == "2"
    assert "policy fault 2" in cells["Outcomes"].text
    assert cells["Object movement"].text.endswith("m²")
    opening = next(row for row in table.rows if row.heads[0] == "Opening")
    movement = [column.label for column in table.columns].index("Object movement")
    assert opening.cells[movement].text.endswith("rad²")


def test_the_episodes_are_listed_as_replay_calls_them(hac):
    (table,) = build_report([hac]).episodes
    first = hac.rows[0]
    row = table.rows[0]
    assert row.heads == (f"{first.task}/{first.index}",)
    texts = [cell.text for cell in row.cells]
    assert texts[2] == str(first.steps)  # a count has no decimals
    assert texts[4] == str(first.touch_interaction)
    assert len(table.rows) == len(hac.rows)
