import csv
import io
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.summary import EPISODE_COLUMNS
from minitouch_bench.reporting.report import (
    TABLE_FORMATS,
    build_report,
    find_videos,
    show_report,
    table4_latex,
    to_html,
    write_views,
)
from tests.comparison.pairs import shown
from tests.reporting.conftest import HOSTILE
from tests.reporting.html_page import Page
from tests.reporting.synthetic import make_run, save, with_shapes, write

PDFLATEX = shutil.which("pdflatex")
LATEX = r"\documentclass{article}\usepackage{booktabs,graphicx}\begin{document}%s\end{document}"


@pytest.fixture(scope="module")
def page(hac, scripted) -> str:
    videos = find_videos([Path("there/videos/pushing_3 a#b.mp4")], Path("there"))
    return to_html(build_report([hac, scripted], videos))


@pytest.mark.parametrize("before", [(), ("opening",)])  # a first run that shares no task with them
def test_runs_of_different_protocols_never_share_a_table(hac, scripted, before):
    digests = {**scripted.header.task_digests, "pushing": "f" * 64}
    other = replace(scripted, header=replace(scripted.header, task_digests=digests))
    runs = [save(make_run(task, tasks=(task,))) for task in before]
    with pytest.raises(UsageError, match=r"'hac-seed1'.*'scripted-smoke'"):
        build_report([*runs, hac, other])


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"tasks": ("sleeping",)}, "there are"),
        ({"metrics": ("luck",)}, "there are"),
        ({"names": ("a", "b")}, "one per run"),
        ({"tasks": ("playing",), "metrics": ("success",)}, "no run has a value"),
    ],
)
def test_what_does_not_exist_cannot_be_chosen(hac, options, word):
    with pytest.raises(UsageError, match=word):
        build_report([hac], **options)


def test_tasks_and_metrics_are_chosen(hac, novel):
    chosen = {"tasks": ("opening", "pushing"), "metrics": ("touched", "success")}
    report = build_report([hac], **chosen)
    assert report.tasks == ("pushing", "opening")  # in the order of every table
    assert [group for group, _ in report.table4.groups] == ["Pushing", "Opening"]
    assert [row.heads for row in report.table4.rows] == [("Success ↑",), ("Touched",)]
    assert {row.heads[0] for row in report.diagnostics.rows} == {"Pushing", "Opening"}
    groups = json.loads(report.episodes)["runs"][0]["groups"]
    assert {one["key"].removeprefix("exploration/") for one in groups} == {"pushing", "opening"}
    only = build_report([novel], tasks=("pushing",))
    assert {row.heads[0] for row in only.novel_shapes[0].rows} == {"Pushing"}


def test_the_page_is_whole_and_loads_nothing_from_anywhere(page, hac):
    value = f"{hac['pushing'].success.value:.3f}"
    video = 'src="videos/pushing_3%20a%23b.mp4"></video><figcaption>pushing 3 a#b<'
    assert all(text in page for text in (value, hac.header.protocol_digest, video))
    parsed = Page(page)
    assert parsed.open == []
    assert len(parsed.ids) == len(set(parsed.ids))
    for _, attributes in parsed.attributes:
        for name in ("src", "href", "xlink:href"):
            address = attributes.get(name) or ""
            assert address.startswith(("#", "data:", "videos/")) or not address, address
    assert "@import" not in page
    assert "default-src 'none'" in page


def test_a_run_of_little_still_has_a_page():
    short = make_run(tasks=("playing",), episodes=1)
    for run in (short, replace(short, records=())):
        assert Page(to_html(build_report([save(run)]))).open == []


def test_hostile_text_is_only_text_in_every_form(hostile):
    shaped = with_shapes(make_run(HOSTILE, tasks=("pushing",), episodes=24, exploration=False))
    specs = (replace(record.spec, family=HOSTILE) for record in shaped.records)
    records = (replace(r, spec=spec) for r, spec in zip(shaped.records, specs, strict=True))
    for run in (hostile, save(replace(shaped, records=tuple(records)), "x")):
        report = build_report([run])
        forms = {name: write(report) for name, write in TABLE_FORMATS.items()}
        forms |= {"page": to_html(report), "screen": shown(show_report, report)}
        for text in forms.values():
            assert "\u202e" not in text
            assert "\x1b[31m" not in text
        assert Page(forms["page"]).open == []
        assert "<script>alert" not in forms["page"]
        assert not re.search(r"(?<!\\)<script", forms["md"])
        assert "[b](c)" in forms["screen"]  # no markup of the terminal's library
        rows = csv.DictReader(io.StringIO(forms["csv"]))
        assert {row["policy"] for row in rows if "cmd" in row["policy"]} == {
            "'" + report.sections[0].name
        }


def test_every_row_of_the_latex_has_as_many_columns(hac, scripted):
    source = table4_latex(build_report([hac, scripted]))
    lines = [line for line in source.splitlines() if " & " in line]
    assert {len(re.split(r"(?<!\\)&", line)) for line in lines} == {6}
    bare = replace(hac, summary=replace(hac.summary, tasks=()))
    assert r"\end{tabular}" in table4_latex(build_report([bare]))


@pytest.mark.skipif(PDFLATEX is None, reason="needs pdflatex: apt-get install texlive-latex-base")
def test_latex_takes_it_with_hostile_names(tmp_path, hac, hostile):
    (tmp_path / "page.tex").write_text(LATEX % table4_latex(build_report([hac, hostile])))
    command = [str(PDFLATEX), "-halt-on-error", "-no-shell-escape", "page.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]


def test_csv_and_json_are_long_and_labeled(hac, scripted):
    report = build_report([hac, scripted])
    rows = list(csv.DictReader(io.StringIO(TABLE_FORMATS["csv"](report))))
    (own,) = [r for r in rows if r["policy"] == "scripted" and r["metric"] == "success"]
    assert own == {
        "policy": "scripted", "task": "pushing", "metric": "success", "value": "1.0",
        "low": own["low"], "high": "1.0", "count": "5", "method": "wilson",
        "source": "run (reads the simulator's state; unofficial: 5 of 100 episodes)",
    }  # fmt: skip
    (paper,) = [r for r in rows if r["policy"] == "HaC" and r["task"] == "playing"]
    assert (paper["metric"], paper["value"], paper["low"]) == ("touch_interaction", "388.15", "")
    assert paper["source"].startswith("paper (other unit, ")
    assert len(json.loads(TABLE_FORMATS["json"](report))) == len(rows)


def test_a_run_has_two_views_of_equal_bytes_apart_from_the_times(tmp_path):
    run = make_run(episodes=5, faults=1)
    environment = replace(run.environment, started="2031-12-31T23:59:59Z", wall_s=1.0)
    first, second = tmp_path / "one" / "run", tmp_path / "two" / "run"
    for folder, made in ((first, run), (second, replace(run, environment=environment))):
        write_views(write(made, folder), folder)
    assert {file.name for file in first.iterdir()} == {"episodes.csv", "report.html", "run.json"}
    assert (first / "episodes.csv").read_bytes() == (second / "episodes.csv").read_bytes()
    later = (second / "report.html").read_text().replace("2031-12-31T23:59:59Z, took 1 s", "WHEN")
    page = (first / "report.html").read_text()
    assert later == page.replace("2025-03-04T10:20:30Z, took 754 s", "WHEN")


def test_episodes_read_back_with_the_published_columns(tmp_path, hac):
    write_views(hac, tmp_path)
    assert b"\r" not in (tmp_path / "episodes.csv").read_bytes()
    frame = pd.read_csv(tmp_path / "episodes.csv")
    assert tuple(frame.columns) == EPISODE_COLUMNS
    assert frame["success"].dtype == bool
    assert frame["object_movement"].tolist() == [e.object_movement for e in hac.rows]
    touched = [e.first_touch_tick is not None for e in hac.rows]
    assert frame["time_to_first_touch"].notna().tolist() == touched
