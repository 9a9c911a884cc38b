import sys
import xml.etree.ElementTree as ET
from dataclasses import replace

import pytest

from minitouch_bench.errors import MissingExtraError, RunDirectoryError
from minitouch_bench.rendering.figure_files import write_figures
from minitouch_bench.reporting.figures import report_figures, split_figures
from minitouch_bench.reporting.report import build_report


@pytest.fixture(scope="module")
def figures(novel, hac):
    report = build_report([novel, hac])
    return (*report_figures(report), *split_figures(report))


def test_every_figure_is_a_vector_drawing_and_a_page(figures, tmp_path):
    paths = write_figures(figures, tmp_path / "new" / "figures")
    assert [path.name for path in paths] == [
        f"{figure.key}.{form}" for figure in figures for form in ("svg", "pdf")
    ]
    for path in paths:
        if path.suffix == ".pdf":
            assert path.read_bytes().startswith(b"%PDF-")
        else:
            texts = [e.text for e in ET.parse(path).iter() if e.tag.endswith("text")]
            assert "Pushing" in texts or "Pushing: success" in texts


def test_equal_figures_give_equal_bytes(figures, tmp_path):
    first = write_figures(figures[:1], tmp_path / "one")
    second = write_figures(figures[:1], tmp_path / "two")
    assert [p.read_bytes() for p in first] == [p.read_bytes() for p in second]


def test_a_name_in_any_script_is_drawn_without_a_warning(hac, tmp_path):
    report = build_report([hac], names=["触覚 🤖 $x$"])
    (drawing, _) = write_figures(report_figures(report)[:1], tmp_path)
    assert "触覚 🤖 $x$" in drawing.read_text(encoding="utf-8")


def test_a_directory_that_cannot_be_written_is_said_in_one_line(figures, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunDirectoryError, match="cannot be written"):
        write_figures(figures[:1], tmp_path / "file")


def test_a_figure_of_many_plots_has_several_rows(figures, tmp_path):
    many = replace(figures[0], plots=figures[0].plots * 2)
    (drawing, _) = write_figures([many], tmp_path)
    assert drawing.read_text(encoding="utf-8").count(">Pushing</text>") == 2


def test_without_matplotlib_the_extra_is_named(figures, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"the extra minitouch-bench\[figures\]"):
        write_figures(figures, tmp_path)
