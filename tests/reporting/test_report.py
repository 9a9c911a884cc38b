from dataclasses import replace
from pathlib import Path

import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.reporting.report import Shown, build_report, find_videos
from tests.reporting.synthetic import make_run, save


@pytest.mark.parametrize("before", [(), ("opening",)])  # a first run that shares no task with them
def test_runs_of_different_protocols_never_share_a_table(hac, scripted, before):
    digests = {**scripted.header.task_digests, "pushing": "f" * 64}
    other = replace(scripted, header=replace(scripted.header, task_digests=digests))
    with pytest.raises(UsageError) as raised:
        build_report([*(save(make_run(task, tasks=(task,))) for task in before), hac, other])
    assert "'hac-seed1'" in str(raised.value)
    assert "'scripted-smoke'" in str(raised.value)


def test_a_report_needs_a_run():
    with pytest.raises(UsageError, match="at least one run"):
        build_report([])


def test_equal_faults_are_told_once(hac):
    (episodes,) = build_report([hac]).sections[0].faults.values()
    assert episodes == ["pushing/0", "pushing/1"]


def test_videos_are_addressed_relative_to_the_report(tmp_path: Path):
    files = [tmp_path / "videos" / "pushing_3 a#b.mp4"]
    video = find_videos(files, tmp_path)[0]
    assert video.caption == "pushing 3 a#b"
    assert video.address == "videos/pushing_3%20a%23b.mp4"


def test_tasks_and_metrics_are_chosen(hac, novel):
    shown = Shown(tasks=("opening", "pushing"), metrics=("touched", "success"))
    report = build_report([hac], shown=shown)
    assert report.tasks == ("pushing", "opening")  # in the order of every table
    assert [group for group, _ in report.table4.groups] == ["Pushing", "Opening"]
    assert [row.heads for row in report.table4.rows] == [("Success ↑",), ("Touched",)]
    assert {row.heads[0] for row in report.diagnostics.rows} == {"Pushing", "Opening"}
    assert len(report.episodes[0].rows) == 2 * 20
    only = build_report([novel], shown=Shown(tasks=("pushing",)))
    assert {row.heads[0] for row in only.novel_shapes[0].rows} == {"Pushing"}


@pytest.mark.parametrize("shown", [Shown(tasks=("sleeping",)), Shown(metrics=("luck",))])
def test_what_does_not_exist_cannot_be_chosen(hac, shown):
    with pytest.raises(UsageError, match="there are"):
        build_report([hac], shown=shown)
