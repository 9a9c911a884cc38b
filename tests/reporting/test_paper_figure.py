"""A figure for a paper, drawn by the real matplotlib; and a report without the paper's values."""

import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.reporting.labels import MARK, PAPER_METHODS
from minitouch_bench.reporting.paper_figure import figure_suffix, write_figure
from minitouch_bench.reporting.report import TABLE_FORMATS, build_report, to_html
from tests.reporting.synthetic import make_run, save


@pytest.fixture(scope="module")
def runs():
    return [save(make_run(name, skill=skill)) for name, skill in (("ours", 0.8), ("x$y$_1", 0.3))]


@pytest.mark.parametrize(
    ("suffix", "magic"), [(".svg", b"<?xml"), (".pdf", b"%PDF"), (".png", b"\x89PNG")]
)
def test_each_kind_is_written_and_is_the_same_again(runs, tmp_path, suffix, magic):
    report = build_report(runs)
    contents = []
    for name in ("one", "again"):
        path = tmp_path / f"{name}{suffix}"
        write_figure(report, (), path)
        contents.append(path.read_bytes())
    assert contents[0] == contents[1]
    assert contents[0].startswith(magic)


def test_runs_are_grouped_by_task_and_named_as_they_are(runs, tmp_path):
    path = tmp_path / "figure.svg"
    write_figure(build_report(runs), (), path)
    text = path.read_text()
    assert [text.count(f">{task}<") for task in ("Pushing", "Opening", "Pick-up", "Playing")] == [
        1, 1, 1, 1,
    ]  # fmt: skip
    assert "Success (share of episodes)" in text
    assert "Touch share" in text
    assert ">x$y$_1<" in text
    write_figure(build_report(runs), ("exploration",), path)
    assert "Playing" not in path.read_text()


def test_what_cannot_be_drawn_is_refused(runs, tmp_path):
    with pytest.raises(UsageError, match=r"\.svg, \.pdf, \.png"):
        figure_suffix(tmp_path / "figure.jpg")
    report = build_report(runs, tasks=("playing",))
    with pytest.raises(UsageError, match="nothing to draw"):
        write_figure(report, ("exploration",), tmp_path / "figure.svg")


def test_without_the_paper_no_form_has_its_values(runs):
    report = build_report(runs, with_paper=False)
    for text in (to_html(report), *(write(report) for write in TABLE_FORMATS.values())):
        assert MARK not in text
        assert "in the paper" not in text
        assert all(f"{method}," not in text for method in PAPER_METHODS)


def test_a_task_without_rows_has_no_heading_and_a_mark_has_its_note(runs):
    of_success = TABLE_FORMATS["md"](build_report(runs, metrics=("success",)))
    assert "Playing" not in of_success
    assert MARK not in of_success
    of_touch = TABLE_FORMATS["md"](build_report(runs, metrics=("touch_interaction",)))
    assert f"{MARK} other unit" in of_touch
