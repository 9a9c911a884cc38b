import re
import shutil
import subprocess
from dataclasses import replace

import pytest

from minitouch_bench.reporting.report import build_report
from minitouch_bench.reporting.writers import table4_latex

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
