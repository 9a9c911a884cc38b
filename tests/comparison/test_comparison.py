import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.comparison.comparison import (
    LISTED_CHANGES,
    compare_runs,
    comparison_html,
)
from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.statistics import holm
from minitouch_bench.metrics.summary import TABLE4_METRICS
from tests.comparison.pairs import draw, flags, make_saved, outside_code, values, with_actions
from tests.reporting.conftest import HOSTILE
from tests.reporting.html_page import Page

TASKS = ("playing", "pushing", "opening", "pick-up")


def drawn(name, skill, seed, n=60):
    hardness = {task: np.random.default_rng(place).random(n) for place, task in enumerate(TASKS)}
    rng = np.random.default_rng(seed)
    return make_saved({task: draw(rng, skill, hardness[task]) for task in TASKS}, name)


GOOD, BAD, GOOD_TOO = drawn("good", 0.9, 1), drawn("bad", 0.4, 2), drawn("good-too", 0.9, 3)
PATHS = ("runs/good", "runs/bad one", "runs/too")


def compared(*runs):
    return compare_runs(runs, PATHS[: len(runs)])


def of_metric(metric, *runs):
    """What the first pair of runs shows of a metric, by task."""
    found = compared(*runs).pairs[0].metrics
    return {one.effect.task: one for one in found if one.effect.metric == metric}


def test_a_clear_difference_is_seen_in_its_direction():
    success = of_metric("success", GOOD, BAD)
    assert [*success] == ["pushing", "opening", "pick-up", "mean"]
    for one in success.values():
        assert one.verdict == "A is better"
        assert one.effect.difference.high < 0
        assert one.effect.worsening > 0
    turned = of_metric("success", BAD, GOOD)
    assert [one.verdict for one in turned.values()] == ["B is better"] * 4


def test_exploration_that_one_run_lacks_is_left_out_and_named():
    explored = replace(GOOD, name="explored", exploration_rows=GOOD.rows)
    for pair in ((explored, BAD), (BAD, explored)):
        found = compared(*pair).pairs[0]
        assert "exploration is left out: 'bad' has none" in found.notes
        assert "exploration" not in {one.effect.metric for one in found.metrics}
        assert "success" in {one.effect.metric for one in found.metrics}
    both = compared(explored, replace(BAD, exploration_rows=BAD.rows)).pairs[0]
    assert "exploration" in {one.effect.metric for one in both.metrics}
    assert not any("left out" in note for note in both.notes)


def of_tasks(name, *tasks):
    return make_saved({task: values(flags(30, 60)) for task in tasks}, name)


def test_tasks_that_one_run_lacks_are_left_out_and_named():
    some = of_tasks("some", "pushing", "opening")
    others = of_tasks("others", "opening", "pick-up")
    for pair in ((GOOD, some), (some, GOOD)):
        found = compared(*pair).pairs[0]
        assert found.notes == ("left out, because 'some' has none: playing, pick-up",)
        tasks = {one.effect.task for one in found.metrics}
        assert tasks == {"pushing", "opening", "mean"}
    found = compared(some, others).pairs[0]
    assert {one.effect.task for one in found.metrics} == {"opening"}
    assert len([note for note in found.notes if note.startswith("left out")]) == 2
    with pytest.raises(UsageError, match="no task to compare: 'some' of pushing and 'others'"):
        compared(of_tasks("some", "pushing"), others)


def test_more_of_a_metric_without_direction_is_neither_better_nor_worse():
    few, many = (
        make_saved({task: values(flags(30, 60), touch=np.full(60, ticks)) for task in TASKS}, name)
        for name, ticks in (("few", 100), ("many", 300))
    )
    for pair, words, best in (((few, many), "B has more", "B"), ((many, few), "B has less", "A")):
        found = of_metric("touch_interaction", *pair)
        wanted = {**dict.fromkeys(TASKS, words), "playing": f"{best} is better"}
        assert {task: one.verdict for task, one in found.items()} == wanted


def test_an_interval_and_its_own_p_value_agree_and_the_verdict_follows_the_adjusted_one():
    # 6 lost and none won: p = 0.031 alone; 0.094 among the three rows of success.
    tasks = {task: values(flags(60, 60)) for task in ("pushing", "opening")}
    other = make_saved({**tasks, "opening": values(flags(54, 60))}, "other")
    alone = of_metric("success", make_saved(tasks, "one"), other)["opening"]
    assert alone.effect.p_value == pytest.approx(2 / 64)
    assert alone.effect.difference.high < 0
    assert alone.p_adjusted > 0.05
    assert alone.verdict == "not clear once adjusted"


def test_holm_is_over_the_tasks_and_runs_of_a_metric():
    comparison = compared(GOOD, BAD, GOOD_TOO)
    assert comparison == compared(GOOD, BAD, GOOD_TOO)
    assert {one.verdict for one in comparison.pairs[1].metrics} == {"no difference seen"}
    findings = [one for found in comparison.pairs for one in found.metrics]
    for metric in ("success", "touch_interaction"):
        own = [one for one in findings if one.effect.metric == metric]
        assert len(own) == 8
        wanted = holm([one.effect.p_value for one in own])
        assert tuple(one.p_adjusted for one in own) == wanted


def test_a_run_beside_itself_is_identical():
    found = compared(GOOD, replace(GOOD, name="again")).pairs[0]
    assert found.identical
    assert found.changes == ()
    assert {(one.verdict, one.p_adjusted, one.needed) for one in found.metrics} == {
        ("equal in every episode", 1.0, None)
    }
    for other in (BAD, replace(BAD, digest=GOOD.digest)):
        assert not compared(GOOD, other).pairs[0].identical


def test_episodes_to_resolve_are_of_each_task_in_the_mean_too():
    """A difference that all tasks have alike takes fewer episodes of each where they are pooled."""
    tasks = ("pushing", "opening", "pick-up")
    first, second = (
        make_saved({task: values(flags(won, 40)) for task in tasks}, str(won)) for won in (30, 25)
    )
    found = of_metric("success", first, second)
    mean, *each = (found[task].needed for task in ("mean", *tasks))
    assert each == [each[0]] * 3
    assert mean == math.ceil(each[0] / 3)


def test_changed_episodes_are_listed_with_commands_that_replay_them(tmp_path):
    changes = compared(*(with_actions(run, tmp_path) for run in (GOOD, BAD))).pairs[0].changes
    before = {(e.task, e.index): e.outcome for e in GOOD.rows}
    after = {(e.task, e.index): e.outcome for e in BAD.rows}
    assert len(changes) == sum(before[key] is not after[key] for key in before) > 20
    first = changes[0]
    shown = f"minitouch-bench replay runs/good {first.episode} --beside 'runs/bad one'"
    assert first.replay == shown
    alone = compared(GOOD, with_actions(BAD, tmp_path))
    one = alone.pairs[0].changes[0]
    assert one.replay == f"minitouch-bench replay 'runs/bad one' {first.episode}"
    (pair,) = json.loads(alone.to_json())["pairs"]
    assert len(pair["changes"]) == len(changes)
    assert {*pair["metrics"][0]["effect"]["difference"]} == {
        "value", "low", "high", "count", "method",
    }  # fmt: skip


def test_the_page_has_a_map_and_a_table_of_each_pair_and_ten_commands(tmp_path):
    runs = [with_actions(run, tmp_path) for run in (GOOD, BAD, GOOD_TOO)]
    html = comparison_html(compare_runs(runs, PATHS), runs)
    page = Page(html)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert {"pair-B", "pair-C", "maps-B", "maps-C", "pair-B-changes"} <= set(page.ids)
    commands = re.findall(r"replay runs/good (\S+) --beside &#39;runs/bad one&#39;", html)
    assert len(commands) == LISTED_CHANGES
    pairs = zip(GOOD.rows, BAD.rows, strict=True)
    lost = sum(a.success and not b.success for a, b in pairs if a.task != "playing")
    counted = sum(map(int, re.findall(r"B against A: gained \d+, lost (\d+)", html)[:3]))
    assert counted == lost  # the fourth is Playing's, which has no success
    assert not re.search(r"(src|href)=\"https?:", html)


def test_what_is_not_alike_beside_the_policies_is_said():
    other = replace(
        GOOD_TOO,
        header=replace(GOOD_TOO.header, isolation="none"),
        environment=replace(
            GOOD_TOO.environment, packages={**GOOD_TOO.environment.packages, "numpy": "2.0.0"}
        ),
        faults={"pushing/3": "NaN"},
    )
    comparison = compared(GOOD, other)
    assert comparison.pairs[0].notes == (
        "isolation: sandbox in the first run, none in the second",
        "numpy: 2.4.6 in the first run, 2.0.0 in the second",
    )
    assert "1 policy fault: NaN" in comparison.runs[1].labels
    assert compared(GOOD, BAD).pairs[0].notes == ()
    packages = {**GOOD.environment.packages, "pybullet-arm64": "3.2.8"}
    del packages["pybullet"]
    built = replace(GOOD_TOO, environment=replace(GOOD_TOO.environment, packages=packages))
    (note,) = compared(GOOD, built).pairs[0].notes  # two builds of the simulator are one difference
    assert {"pybullet 3.2.7", "pybullet-arm64 3.2.8"} <= {*re.findall(r"pybullet\S* [\d.]+", note)}


def test_each_metric_of_table_4_has_the_values_of_run_json_to_the_last_bit(hac, novel):
    for run in (hac, novel):
        other = replace(run, name="other", digest="other")
        (pair,) = compare_runs((run, other), ("a", "b")).pairs
        effects = [one.effect for one in pair.metrics if one.effect.task != "mean"]
        stored = {
            (part.task, metric): estimate.value
            for part in run.summary.tasks
            for metric, estimate in part.estimates.items()
            if metric in TABLE4_METRICS
        }
        assert {(one.task, one.metric): one.first for one in effects} == stored


def test_hostile_names_are_harmless_everywhere(tmp_path):
    named = make_saved({"pushing": values([True, False] * 4)}, HOSTILE)
    hostile = replace(named, faults={"pushing/1": HOSTILE})
    comparison = compare_runs((hostile, replace(hostile, digest="x")), (HOSTILE, HOSTILE))
    comparison.write(tmp_path)
    page, screen = (tmp_path / "comparison.md").read_text(), str(comparison)
    assert not any(sign in text for sign in "\x1b\u202e" for text in (page, screen))
    assert "<script>" not in outside_code(page)
    assert "<script>" in screen  # as text
    assert outside_code(comparison._repr_markdown_()) in outside_code(page)
