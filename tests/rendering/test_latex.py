import re
import shutil
import subprocess
from dataclasses import replace

import pandas as pd
import pytest

from minitouch_bench.rendering.latex import table_source
from minitouch_bench.reporting.claims import Claim, claims_table, judge_claims
from minitouch_bench.reporting.report import build_report, table4_latex

CLAIMS = claims_table(
    judge_claims(
        [Claim("success", ("pushing",), "hac", ("rnd",))],
        pd.DataFrame(columns=["task", "method", "seed", "metric", "value"]),
    )
)
PDFLATEX = shutil.which("pdflatex")
PAGE = r"\documentclass{article}\usepackage{booktabs,graphicx}\begin{document}%s\end{document}"


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


def test_a_table_of_claims_has_no_character_that_latex_does_not_know():
    source = table_source(CLAIMS, "Claims.")
    assert r"hac \textgreater{} rnd" in source
    assert r"Confirmed: p $\leq$ 0.05" in source
    assert source.isascii()


def test_a_run_without_estimates_is_an_empty_table(hac):
    bare = replace(hac, summary=replace(hac.summary, tasks=()))
    assert r"\end{tabular}" in table4_latex(build_report([bare]))


@pytest.mark.skipif(PDFLATEX is None, reason="needs pdflatex: apt-get install texlive-latex-base")
def test_latex_takes_it_with_hostile_names(tmp_path, hac, hostile):
    runs = [hac, hostile]
    digests = {run.header.protocol_digest for run in runs}
    assert len(digests) == 1
    tables = (table4_latex(build_report(runs)), table_source(CLAIMS, "Claims."))
    (tmp_path / "page.tex").write_text(PAGE % "".join(tables))
    command = [str(PDFLATEX), "-halt-on-error", "-no-shell-escape", "page.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
