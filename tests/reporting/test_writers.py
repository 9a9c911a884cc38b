"""Markdown, terminal and SVG: what every writer of a report owes its reader."""

import re
import xml.etree.ElementTree as ET

import pytest
from rich.console import Console

from minitouch_bench.rendering.escaping import printable
from minitouch_bench.rendering.markdown import escape
from minitouch_bench.reporting import plots
from minitouch_bench.reporting.cards import build_cards, picture_uri
from minitouch_bench.reporting.markdown import to_markdown
from minitouch_bench.reporting.report import build_report
from minitouch_bench.reporting.terminal import show_report


def test_printable_keeps_one_line_of_visible_text():
    assert printable("a\nb\tc\x1b[31m\u202ed\x00\ud800 ü ↑") == "a b c[31md ü ↑"


@pytest.mark.parametrize(
    ("text", "escaped"),
    [
        ("a|b", r"a\|b"),
        ("[x](y)", r"\[x\](y)"),
        ("<b>", r"\<b\>"),
        ("0.970", "0.970"),
        ("1. x", r"1\. x"),
        ("- x", r"\- x"),
        ("-1.5", "-1.5"),
        ("snake_case", r"snake\_case"),
    ],
)
def test_markdown_is_escaped(text, escaped):
    assert escape(text) == escaped


def test_markdown_has_tables_labels_faults_and_the_command(hac, scripted):
    text = to_markdown(build_report([hac, scripted]))
    assert "## Table 4" in text
    assert "RND+touch (paper)" in text
    assert "unofficial: 5 of 100 episodes" in text
    assert "act() gave NaN in element 2 of 4" in text
    assert "minitouch-bench evaluate checkpoints/hac-seed1.safetensors" in text
    lines = [line for line in text.splitlines() if line.startswith("|")]
    widths = {len(re.findall(r"(?<!\\)\|", line)) for line in lines[:6]}
    assert len(widths) == 1


def test_markdown_of_a_hostile_run_holds_no_markup(hostile):
    text = to_markdown(build_report([hostile]))
    outside_code = re.sub(r"(`+).*?[^`]\1(?!`)", "", text)
    assert not re.search(r"(?<!\\)<script", outside_code)
    assert "\x1b" not in text
    assert "\u202e" not in text


def test_terminal_prints_both_tables(hac, scripted):
    console = Console(width=140, record=True, file=None, quiet=False, force_terminal=False)
    with console.capture() as captured:
        show_report(build_report([hac, scripted]), console)
    text = captured.get()
    for expected in ("Pushing", "(paper)", "0.733", "Diagnostics", "reads the simulator's"):
        assert expected in text


def test_terminal_reads_no_markup_and_prints_no_escapes(hostile):
    console = Console(width=200)
    with console.capture() as captured:
        show_report(build_report([hostile]), console)
    assert "[b](c)" in captured.get()
    assert "\x1b[31m" not in captured.get()


DRAWINGS = [
    lambda sections: plots.estimate_plot("pushing", "success", sections),
    lambda sections: plots.estimate_plot("playing", "touch_interaction", sections),
    lambda sections: plots.steps_plot("pushing", sections),
    lambda sections: plots.touch_plot("pushing", sections),
]


@pytest.mark.parametrize("draw", DRAWINGS)
def test_plots_take_the_colours_of_the_page_and_repeat(draw, hac, scripted):
    sections = build_report([hac, scripted]).sections
    drawing = draw(sections)
    ET.fromstring(drawing)
    assert "var(--series-0)" in drawing or "var(--outcome-0)" in drawing
    assert "#0103" not in drawing
    assert "#ffffff" not in drawing
    assert "<style" not in drawing
    assert "<metadata" not in drawing
    assert 'role="img"' in drawing
    assert drawing == draw(sections)


def test_axes_name_their_units(hac):
    sections = build_report([hac]).sections
    assert "Success (share of episodes)" in DRAWINGS[0](sections)
    assert "Touch-interaction (ticks)" in DRAWINGS[1](sections)
    assert "Episode steps (control steps)" in DRAWINGS[2](sections)
    assert "Contact (ticks per step)" in DRAWINGS[3](sections)


@pytest.mark.parametrize("draw", [DRAWINGS[0], DRAWINGS[2], DRAWINGS[3]])
def test_a_hostile_name_cannot_leave_its_plot(draw, hostile):
    drawing = draw(build_report([hostile]).sections)
    ET.fromstring(drawing)
    assert "<script" not in drawing


def test_a_name_in_any_script_draws_without_a_warning(hac):
    section = build_report([hac]).sections[0]
    renamed = type(section)("触覚 🤖 $x$", (), (), "", hac)
    assert "触覚 🤖 $x$" in plots.estimate_plot("pushing", "success", [renamed])


def test_cards_show_the_verdict_and_the_paper(hac):
    cards = build_cards(build_report([hac]))
    assert [card.title for card in cards] == ["Pushing", "Opening", "Pick-up", "Playing"]
    pushing, playing = cards[0], cards[-1]
    assert pushing.paper == "HaC in the paper: 0.733"
    assert pushing.figures[0].gauge.paper == 73.3
    assert playing.metric == "Touch share"
    assert 0 < playing.figures[0].gauge.value < 100


def test_a_missing_picture_is_left_out(tmp_path):
    assert picture_uri("pushing", tmp_path) == ""
    (tmp_path / "pushing.png").write_bytes(b"\x89PNG")
    assert picture_uri("pushing", tmp_path) == "data:image/png;base64,iVBORw=="
