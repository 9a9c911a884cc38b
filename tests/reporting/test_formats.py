"""Tables and text of strangers as Markdown and LaTeX."""

import re
import shutil
import subprocess
from dataclasses import replace

import pytest

from minitouch_bench.errors import printable
from minitouch_bench.reporting.report import build_report, table4_latex
from minitouch_bench.reporting.tables import (
    ABSENT,
    WIDEST,
    Column,
    Table,
    escape_md,
    escape_tex,
    make_row,
    table_section,
)

PDFLATEX = shutil.which("pdflatex")
PAGE = r"\documentclass{article}\usepackage{booktabs,graphicx}\begin{document}%s\end{document}"


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
    assert escape_md(text) == escaped


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
    assert escape_tex(text) == escaped


def grouped(columns):
    """A table of two blocks of so many columns; the second block has one value."""
    labels = [Column(f"m{index}", group) for group in ("Pushing", "Opening") for index in columns]
    first = ["1"] * len(columns)
    return Table(
        "Table 4",
        ("Metric",),
        tuple(labels),
        (
            make_row("Success", *first, "2", *[ABSENT] * (len(columns) - 1)),
            make_row("Exploration", *first, *[ABSENT] * len(columns)),
        ),
        ("a note",),
    )


def test_a_table_that_fits_is_one():
    lines = table_section(grouped(range(WIDEST // 2)))
    assert sum(line.startswith("| ---") for line in lines) == 1
    assert lines[-1] == "- a note"


def test_a_wide_table_is_one_per_block_without_what_is_empty():
    lines = table_section(grouped(range(WIDEST // 2 + 1)))
    first, second = (line for line in lines if line.startswith("| Metric"))
    assert first.count("Pushing<br>m") == WIDEST // 2 + 1
    assert second == "| Metric | Opening<br>m0 |"
    assert lines.count("| Success | 2 |") == 1
    assert not any("Exploration | — |" in line for line in lines)
    assert lines.count("- a note") == 1


def test_table_4_has_a_block_per_task(hac, scripted):
    source = table4_latex(build_report([hac, scripted]))
    assert source.count(r"\midrule") == 4
    assert r"\multicolumn{6}{l}{\textbf{Pick-up}}" in source
    assert r"Success $\uparrow$ & " in source
    assert source.count(r"\textit{RND+touch}") == 1
    assert r"247.79\textdagger{}" in source
    assert r"\scriptsize share of episodes" in source
    lines = [line for line in source.splitlines() if " & " in line]
    assert {len(re.split(r"(?<!\\)&", line)) for line in lines} == {6}


def test_a_run_without_estimates_is_an_empty_table(hac):
    bare = replace(hac, summary=replace(hac.summary, tasks=()))
    assert r"\end{tabular}" in table4_latex(build_report([bare]))


@pytest.mark.skipif(PDFLATEX is None, reason="needs pdflatex: apt-get install texlive-latex-base")
def test_latex_takes_it_with_hostile_names(tmp_path, hac, hostile):
    runs = [hac, hostile]
    digests = {run.header.protocol_digest for run in runs}
    assert len(digests) == 1
    (tmp_path / "page.tex").write_text(PAGE % table4_latex(build_report(runs)))
    command = [str(PDFLATEX), "-halt-on-error", "-no-shell-escape", "page.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
