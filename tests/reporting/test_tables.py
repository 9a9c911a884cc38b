"""Tables and texts of strangers on a terminal, as Markdown, LaTeX and CSV."""

import io
import re

import pytest
from rich.console import Console

from minitouch_bench.comparison.comparison import Comparison, compare_runs
from minitouch_bench.reporting.report import build_report, escape_tex, show_report
from minitouch_bench.reporting.tables import escape_md, rows_csv
from minitouch_bench.text import printable
from tests.reporting.synthetic import make_run, save


@pytest.fixture(scope="module")
def runs():
    names = ("hac", "icm-touch", "a policy of three words", "checkpoint_of_a_very_long_name_indeed")
    return [save(make_run(name, skill=0.9 - 0.2 * i), name) for i, name in enumerate(names)]


def on_screen(width, show, what):
    console = Console(width=width, file=io.StringIO())
    show(what, console)
    return console.file.getvalue().splitlines()


def numbers(lines):
    """Every number that no end of a line cuts, and each interval as a whole."""
    found = re.compile(r"[\[+-]?(?<!\d)\d+\.\d+(?:e-\d+)?(?:, [+-]?\d+\.\d+(?:e-\d+)?\])?†?")
    return sorted(number for line in lines for number in found.findall(line))


@pytest.mark.parametrize("width", [30, 41, 55, 80, 81, 100, 141])
def test_a_narrow_screen_has_every_number_that_a_wide_one_has(width, runs):
    report, comparison = build_report(runs), compare_runs(runs[:2], ("a", "b"))
    shown = ((show_report, report), (Comparison.show, comparison))
    for show_it, what in shown:
        wide, narrow = (on_screen(columns, show_it, what) for columns in (1000, width))
        tables = [line for line in narrow if not line.startswith(("A: ", "B: "))]
        assert max(map(len, narrow)) <= width
        assert numbers(wide)
        rows = {line.split()[0] for line in wide if line.startswith(" ")}
        assert all(any(row in line for line in tables) for row in rows)
        for number in set(numbers(wide)):
            assert numbers(narrow).count(number) == numbers(wide).count(number), number


def test_names_stay_beside_the_numbers_that_were_split_from_them(runs):
    """Where four runs do not fit, each part of the table names its rows again."""
    lines = on_screen(80, show_report, build_report(runs, tasks=("pushing",)))
    parts = [i for i, line in enumerate(lines) if line.split()[:1] == ["Metric"]]
    assert len(parts) > 1
    for start in parts:
        assert any(line.split()[:1] == ["Success"] for line in lines[start : start + 5])


def test_printable_keeps_one_line_of_visible_text():
    assert printable("a\nb\tc\x1b[31m\u202ed\x00\ud800 ü ↑") == "a b c[31md ü ↑"
    for code in (0x200B, 0xFEFF, 0xE0041, 0xFE0F, 0xE0100, 0x3164, 0x2800, 0x34F):
        assert printable(f"ha{chr(code)}c") == "hac"


@pytest.mark.parametrize(
    ("escape", "text", "escaped"),
    [
        (escape_md, "a|b <b> [x](y)", r"a\|b \<b\> \[x\](y)"),
        (escape_md, "1. x", r"1\. x"),
        (escape_md, "- x", r"\- x"),
        (escape_md, "-1.5", "-1.5"),
        (escape_md, "snake_case", r"snake\_case"),
        (escape_tex, "hac_seed1 & 50 %", r"hac\_seed1 \& 50 \%"),
        (escape_tex, r"\input{x}", r"\textbackslash{}input\{x\}"),
        (escape_tex, "$x^2$ ~#", r"\$x\textasciicircum{}2\$ \textasciitilde{}\#"),
        (escape_tex, "↑ — m² ≤ ≥", r"$\uparrow$ --- m\textsuperscript{2} $\leq$ $\geq$"),
        (escape_tex, "< > |", r"\textless{} \textgreater{} \textbar{}"),
    ],
)
def test_text_is_escaped(escape, text, escaped):
    assert escape(text) == escaped


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@x", "\t=1", "\r=1", "\u202e=1"])
def test_no_text_of_a_csv_is_run_as_a_formula_and_a_number_stays_one(text):
    cell, number, flag = rows_csv("abc", [(text, -3.5, True)]).splitlines()[1].split(",")
    assert cell.startswith("'")
    assert (number, flag) == ("-3.5", "true")
