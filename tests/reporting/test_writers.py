"""Markdown, terminal, figures and cards: what a report owes its reader."""

import re

import pytest
from rich.console import Console

from minitouch_bench.reporting.charts import Bar
from minitouch_bench.reporting.figures import report_figures
from minitouch_bench.reporting.pages import image_uri
from minitouch_bench.reporting.report import TABLE_FORMATS, build_report, report_card, show_report


def parts(runs):
    report = build_report(runs)
    return report.sections, report.tasks


def test_markdown_is_the_table_and_its_notes(hac, scripted):
    text = TABLE_FORMATS["md"](build_report([hac, scripted]))
    assert text.startswith("## Table 4")
    assert "RND+touch (paper)" in text
    assert "unofficial: 5 of 100 episodes" in text
    lines = [line for line in text.splitlines() if line.startswith("|")]
    widths = {len(re.findall(r"(?<!\\)\|", line)) for line in lines[:6]}
    assert len(widths) == 1


def test_markdown_of_a_hostile_run_holds_no_markup(hostile):
    text = TABLE_FORMATS["md"](build_report([hostile]))
    assert not re.search(r"(?<!\\)<script", text)
    assert "\x1b" not in text
    assert "\u202e" not in text


def test_terminal_prints_both_tables(hac, scripted):
    console = Console(width=140, record=True, file=None, quiet=False, force_terminal=False)
    with console.capture() as captured:
        show_report(build_report([hac, scripted]), console)
    text = captured.get()
    fault = "act() gave NaN in element 2 of 4 (2 episodes: pushing/0, pushing/1)"
    for expected in ("Pushing", "(paper)", "0.733", "Diagnostics", "reads the simulator's", fault):
        assert expected in text


def test_terminal_reads_no_markup_and_prints_no_escapes(hostile):
    console = Console(width=200)
    with console.capture() as captured:
        show_report(build_report([hostile]), console)
    assert "[b](c)" in captured.get()
    assert "\x1b[31m" not in captured.get()


def test_axes_name_their_units(hac):
    labels = [
        (figure.plots[0].charts[0].x.label, figure.plots[0].charts[0].y.label)
        for figure in report_figures(*parts([hac]))
    ]
    assert labels == [
        ("Success, share of episodes", ""),
        ("Control steps", "Episodes, %"),
        ("Control steps", "Ticks per step"),
    ]


def test_the_paper_stands_beside_success_and_never_on_an_axis_of_touch(hac):
    compared = report_figures(*parts([hac]))[0]
    rows = {plot.caption: [t.text for t in plot.charts[0].y.ticks] for plot in compared.plots}
    assert rows["Pushing"] == ["hac-seed1", "HaC", "RND+touch", "RND"]
    assert rows["Playing"] == ["hac-seed1"]


def test_every_run_has_a_panel_of_its_own(hac, scripted):
    steps = report_figures(*parts([hac, scripted]))[1].plots[0]
    assert [chart.title for chart in steps.charts] == ["hac-seed1", "scripted"]
    total = [sum(m.top - m.bottom for m in c.marks if isinstance(m, Bar)) for c in steps.charts]
    assert total == pytest.approx([100, 100])


def test_the_report_on_one_run_has_no_legend_of_runs(hac):
    assert report_figures(*parts([hac]))[2].legend == ()


def test_cards_show_the_verdict_and_the_paper(hac):
    report = build_report([hac])
    cards = [report_card(report, task) for task in report.tasks]
    assert [card.title for card in cards] == ["Pushing", "Opening", "Pick-up", "Playing"]
    pushing, playing = cards[0], cards[-1]
    assert pushing.paper == "HaC in the paper: 0.733"
    assert pushing.values[0].cell.gauge.mark == 73.3
    assert playing.metric == "Touch share, share of control steps"
    assert playing.paper == ""
    assert 0 < playing.values[0].cell.gauge.value < 100


def test_a_missing_picture_is_left_out(tmp_path):
    assert image_uri("pushing", tmp_path) == ""
    (tmp_path / "pushing.png").write_bytes(b"\x89PNG")
    assert image_uri("pushing", tmp_path) == "data:image/png;base64,iVBORw=="
