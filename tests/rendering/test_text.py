"""Text of strangers, as each format may print it."""

import pytest

from minitouch_bench.rendering import latex, markdown
from minitouch_bench.rendering.escaping import printable


def test_printable_keeps_one_line_of_visible_text():
    assert printable("a\nb\tc\x1b[31m\u202ed\x00\ud800 ü ↑") == "a b c[31md ü ↑"


@pytest.mark.parametrize("code", [0x200B, 0xFEFF, 0xE0041, 0xFE0F, 0xE0100, 0x3164, 0x2800, 0x34F])
def test_what_cannot_be_seen_is_removed(code):
    assert printable(f"ha{chr(code)}c") == "hac"


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
    assert markdown.escape(text) == escaped


@pytest.mark.parametrize(
    ("text", "escaped"),
    [
        ("hac_seed1 & 50 %", r"hac\_seed1 \& 50 \%"),
        (r"\input{x}", r"\textbackslash{}input\{x\}"),
        ("$x^2$ ~#", r"\$x\textasciicircum{}2\$ \textasciitilde{}\#"),
        ("Success ↑ — m²", r"Success $\uparrow$ --- m\textsuperscript{2}"),
        ("hac > rnd | p ≤ 0.05", r"hac \textgreater{} rnd \textbar{} p $\leq$ 0.05"),
        ("< 0.001 ≥", r"\textless{} 0.001 $\geq$"),
    ],
)
def test_latex_is_escaped(text, escaped):
    assert latex.escape(text) == escaped
