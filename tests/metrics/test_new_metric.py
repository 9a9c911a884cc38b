"""Proof by doing: a metric is one value with its statistic, and then it is in every table."""

import json

import pytest

from tests.altered import ROOT
from tests.process_tree import run_python

SCRIPT = """
import sys
from pathlib import Path
from minitouch_bench.metrics.definitions import DOWN, METRICS, Metric, ShownIn
from minitouch_bench.metrics.statistics import SHARE

METRICS["long_episode"] = Metric(
    "long_episode", "Long episode", "share of episodes", "D", ".3f", "episodes beyond 100 steps",
    direction=DOWN, needs_goal=True, statistic=SHARE, added_later=True,
    derive=lambda episode: episode.steps > 100,
    shown_in=ShownIn.TABLE4 | ShownIn.NOVEL_SHAPES,
)

from minitouch_bench.leaderboard import fresh
from minitouch_bench.leaderboard.site import build_board
from minitouch_bench.metrics import statistics
from minitouch_bench.comparison.comparison import compare_runs
from minitouch_bench.comparison.gate import GateSettings, judge_runs
from minitouch_bench.comparison.gate_report import gate_markdown
from minitouch_bench.reporting.tables import as_markdown
from minitouch_bench.reporting.report import build_report, report_blocks, table4_latex, to_html
from minitouch_bench.runs.run import read_run
from minitouch_bench.verification.static_check import check_run
from minitouch_bench.episode import PolicyIdentity, Role
from minitouch_bench.runs.plan import make_plan
from tests.leaderboard.synthetic import make_row
from tests.reporting.synthetic import played, write

root, stored = map(Path, sys.argv[1:])
(root / "stored.txt").write_text("".join(map(str, check_run(read_run(stored)))))
whole = statistics.bootstrap
statistics.bootstrap = lambda values, rng: whole(values, rng, 100)
fresh.ORDERS = 1000
policies = {Role.FINAL: PolicyIdentity("hac", "hac.safetensors", "native", "ab" * 32)}
for name, skill in (("better", 0.9), ("worse", 0.4), ("novel", 0.9)):
    suite = "novel-shapes" if name == "novel" else "table4"
    write(played(make_plan(suite), policies, skill, 0), root / name)
runs = [read_run(root / name) for name in ("better", "worse")]
paths = tuple(str(root / run.name) for run in runs)
for name, text in {
    "report.md": "\\n".join(as_markdown(report_blocks(build_report([runs[0]])))),
    "report.tex": table4_latex(build_report([runs[0]])),
    "report.html": to_html(build_report([runs[0]])),
    "novel.html": to_html(build_report([read_run(root / "novel")])),
    "compare.txt": str(compare_runs(runs, paths)),
    "compare.json": compare_runs(runs, paths).to_json(),
    "regress.md": gate_markdown(judge_runs(*runs, paths, GateSettings(metric="long_episode"))),
    "new.txt": "".join(map(str, check_run(runs[0]))),
}.items():
    (root / name).write_text(text)
make_row(root, "hac", 0.8)
make_row(root, "seeds", 0.6, seeds=(0, 1, 2))
build_board(root / "submissions", root / "board", root / "results")
"""

STORED = ROOT / "reports" / "baseline" / "random"


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """What a program with one metric more writes."""
    root = tmp_path_factory.mktemp("metric")
    run_python("-c", SCRIPT, root, STORED, cwd=ROOT)
    return root


def test_it_is_estimated_with_its_own_interval(root):
    document = json.loads((root / "worse" / "run.json").read_text())
    for task in document["summary"]["tasks"]:
        if task["task"] == "playing":
            assert "long_episode" not in task["estimates"]
            continue
        steps = [e["steps"] for e in document["episodes"] if e["task"] == task["task"]]
        found = task["estimates"]["long_episode"]
        assert found["value"] == sum(one > 100 for one in steps) / len(steps) > 0
        assert found["low"] < found["value"] < found["high"] <= 1
        assert found["method"] == "wilson"


def test_it_is_in_every_table(root):
    for page in (
        "report.md", "report.html", "report.tex", "novel.html", "compare.txt", "regress.md",
        "board/index.html", "board/submission/seeds.html",
    ):  # fmt: skip
        assert "Long episode" in (root / page).read_text(), page


def test_two_policies_are_compared_by_its_own_test(root):
    (pair,) = json.loads((root / "compare.json").read_text())["pairs"]
    effects = [m["effect"] for m in pair["metrics"] if m["effect"]["metric"] == "long_episode"]
    assert {one["task"] for one in effects} == {"pushing", "opening", "pick-up"}  # no mean of them
    assert {one["difference"]["method"] for one in effects} == {"tango"}
    for one in effects:
        assert one["difference"]["value"] == pytest.approx(one["second"] - one["first"])


def test_stored_runs_stay_valid(root):
    assert (root / "new.txt").read_text() == ""
    assert "long_episode" not in (STORED / "run.json").read_text()
    assert (root / "stored.txt").read_text() == ""
