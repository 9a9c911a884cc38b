"""Tables and texts of strangers as Markdown, LaTeX and CSV."""

import pytest

from minitouch_bench.errors import printable
from minitouch_bench.reporting.tables import escape_md, escape_tex, rows_csv


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
