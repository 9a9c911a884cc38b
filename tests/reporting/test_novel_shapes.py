"""Held-out beside train shapes, from the run's document to every writer."""

import json
import re
from dataclasses import replace

import jsonschema
import pytest
from rich.console import Console

from benchmarks.schemas import run_schema
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.metrics.intervals import Estimate
from minitouch_bench.reporting.charts import Dot
from minitouch_bench.reporting.figures import split_figures
from minitouch_bench.reporting.report import build_report, show_report, to_html, write_views
from minitouch_bench.reporting.run_tables import verdict
from minitouch_bench.reporting.tables import ABSENT
from minitouch_bench.runs.run import parse_run, run_json
from tests.reporting.conftest import HOSTILE
from tests.reporting.synthetic import (
    SHAPE_TASKS,
    make_run,
    measured,
    save,
    with_shapes,
    without_success,
    write,
)

VALIDATOR = jsonschema.Draft202012Validator(run_schema())


def parts(runs):
    report = build_report(runs)
    return report.sections, report.tasks


def novel_run(name: str = "hac-seed1", **options):
    return with_shapes(make_run(name, tasks=SHAPE_TASKS, episodes=24, exploration=False, **options))


def document_of(run):
    done = measured(run)
    return done.summary, json.loads(run_json(done))


def test_the_document_follows_the_schema_and_reads_back():
    summary, document = document_of(novel_run())
    VALIDATOR.validate(document)
    assert len(summary.generalization) == 3
    assert parse_run(json.dumps(document).encode(), "x").summary == summary


def test_a_run_of_one_split_has_no_generalization_in_its_document():
    _, document = document_of(make_run(episodes=24))
    assert document["summary"]["generalization"] == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(task="juggling"), "this version has no task 'juggling'"),
        (lambda d: d.pop("gaps"), "missing required field gaps"),
        (lambda d: d["gaps"]["success"].pop("train"), "missing required field train"),
        (lambda d: d["gaps"]["success"]["difference"].update(low="0"), "expected float, got str"),
        (lambda d: d["families"]["carved"].update(train=3), "expected object"),
    ],
)
def test_a_malformed_document_gives_one_clear_line(change, message):
    _, document = document_of(novel_run())
    change(document["summary"]["generalization"][1])
    assert not VALIDATOR.is_valid(document)
    with pytest.raises(RunDirectoryError, match=message):
        parse_run(json.dumps(document).encode(), "x")


def test_files_and_equal_bytes(tmp_path):
    for place in ("one", "two"):
        run = write(novel_run(), tmp_path / place / "run")
        write_views(run, tmp_path / place / "run")
    files = sorted(file.name for file in (tmp_path / "one" / "run").iterdir())
    for name in files:
        first = (tmp_path / "one" / "run" / name).read_bytes()
        assert first == (tmp_path / "two" / "run" / name).read_bytes(), name


def test_a_run_of_one_split_has_no_section(hac):
    run = save(make_run(episodes=24))
    report = build_report([run, hac])
    assert report.novel_shapes == ()
    assert "Novel shapes" not in to_html(report)
    assert "over all shapes" not in "".join(build_report([run]).table4.notes)


def test_hostile_names_are_harmless():
    run = novel_run(HOSTILE)
    specs = (replace(r.spec, family=HOSTILE) for r in run.records)
    records = tuple(replace(r, spec=s) for r, s in zip(run.records, specs, strict=True))
    saved = save(replace(run, records=records), "x")
    report = build_report([saved])
    assert "<script" not in to_html(report)
    assert "\u202e" not in to_html(report)


@pytest.mark.parametrize(
    ("metric", "low", "high", "words"),
    [
        ("touch_interaction", 1.0, 2.0, "more on held-out"),
        ("touch_share", 0.1, 0.2, "more on held-out"),
        ("success", -0.1, 0.1, "no difference seen"),
        ("success", -0.1, 0.0, "no difference seen"),
        ("success", -0.2, -0.1, "worse on held-out"),
        ("success", 0.1, 0.2, "better on held-out"),
        ("episode_steps", 1.0, 2.0, "worse on held-out"),
        ("episode_steps", -2.0, -1.0, "better on held-out"),
        ("object_movement", 1e-4, 2e-4, "more on held-out"),
        ("object_movement", -2e-4, -1e-4, "less on held-out"),
    ],
)
def test_the_verdict_says_what_the_interval_says(metric, low, high, words):
    estimate = Estimate((low + high) / 2, low, high, 40, "bootstrap")
    assert verdict("pushing", metric, estimate) == words


def test_only_playing_is_better_with_more_ticks_of_touch():
    estimate = Estimate(1.5, 1.0, 2.0, 40, "bootstrap")
    assert verdict("playing", "touch_interaction", estimate) == "better on held-out"


def test_the_gap_table_has_a_row_a_metric(novel):
    table = build_report([novel]).novel_shapes[0]
    assert [row.heads for row in table.rows][:2] == [
        ("Pushing", "Success ↑"),
        ("Pushing", "Episode steps ↓"),
    ]
    assert len(table.rows) == 13
    gap = table.rows[0].cells[2]
    assert gap.text[0] in "+-"
    assert re.fullmatch(r"\[[+-]\d\.\d{3}, [+-]\d\.\d{3}\]", gap.small)


def test_a_gap_of_nothing_is_plus_zero(novel):
    none = save(without_success(without_success(novel_run(), "train"), "held-out"), "none")
    assert build_report([none]).novel_shapes[0].rows[0].cells[2].text == "+0.000"


def test_several_runs_stand_side_by_side(novel, hac):
    other = save(novel_run("other", notes=("remote",)), "other")
    gaps, families = build_report([novel, other, hac]).novel_shapes
    assert [group for group, _ in gaps.groups] == ["hac-seed1 (novel)", "other\u00a0*"]
    assert [row.heads for row in families.rows[:2]] == [
        ("carved", "hac-seed1 (novel)"),
        ("carved", "other\u00a0*"),
    ]
    assert families.groups[-1][0] == "Playing: touch share"
    assert families.rows[-1].cells[0].text == ABSENT
    assert families.rows[-1].cells[1].text == "0"
    assert "* other: remote." in gaps.notes


def test_table4_says_that_it_is_over_both_splits(novel):
    assert "“Novel shapes” has them apart" in "".join(build_report([novel]).table4.notes)
    few = save(with_shapes(make_run(episodes=4, exploration=False)), "few")
    assert "needs 10 episodes of each" in "".join(build_report([few]).table4.notes)


def test_every_writer_has_the_section(novel):
    report = build_report([novel])
    console = Console(width=120)
    with console.capture() as captured:
        show_report(report, console)
    for text in (to_html(report), captured.get()):
        for expected in ("Novel shapes", "Held-out", "Gap", "by family", "harmonic"):
            assert expected in text
        assert "no difference seen" in text or "on held-out" in text


def test_the_page_has_the_figures(novel):
    page = to_html(build_report([novel]))
    assert "Held-out beside train shapes" in page
    assert page.count("on each split") == 9
    ids = re.findall(r'<h2 id="([^"]+)"', page)
    assert len(ids) == len(set(ids))


def test_both_figures_have_a_plot_per_task_and_name_their_units(novel, hac):
    pairs, families = split_figures(*parts([novel, hac]))
    assert [plot.caption for plot in families.plots] == ["Pushing", "Pick-up", "Playing"]
    assert [plot.caption for plot in pairs.plots][::2] == [
        "Pushing: success",
        "Pick-up: success",
        "Playing: touch share",
    ]
    assert pairs.plots[1].charts[0].x.label == "Episode steps, control steps"
    assert [item.text for item in pairs.legend] == [
        "held-out shapes",
        "train shapes",
        "hac-seed1 (novel)",
        "hac-seed1 (hac-seed1)",
    ]


def test_a_mark_stands_where_its_estimate_is(novel):
    pushing = split_figures(*parts([novel]))[0].plots[0]
    gap = next(r for r in novel.summary.generalization if r.task == "pushing").gaps["success"]
    dots = [mark for mark in pushing.charts[0].marks if isinstance(mark, Dot)]
    assert [(dot.x, dot.is_hollow) for dot in dots] == [
        (gap.held_out.value, False),
        (gap.train.value, True),
    ]
