import io
import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from rich.console import Console

from minitouch_bench.errors import UsageError
from minitouch_bench.regression.gate import Decision, judge_runs, overall
from minitouch_bench.regression.settings import GateSettings, Tolerance
from minitouch_bench.regression.tables import result_line
from minitouch_bench.regression.writers import gate_json, gate_junit, gate_markdown, show_result
from tests.regression.pairs import flags, make_saved, values
from tests.reporting.conftest import HOSTILE

N = 100
BASELINE = make_saved({"pushing": values(flags(90, N)), "opening": values(flags(95, N))}, "base")
SUCCESS = GateSettings(metrics=("success",))


def candidate(pushing, opening=95, name="candidate"):
    tasks = {"pushing": values(flags(pushing, N)), "opening": values(flags(opening, N))}
    return make_saved(tasks, name)


def judged(other, settings=SUCCESS, baseline=BASELINE):
    return judge_runs(baseline, other, ("runs/base", "runs/new"), settings)


def by_task(result):
    return {one.effect.task: one.decision for one in result.judged}


def test_a_clear_worsening_is_a_regression():
    result = judged(candidate(70))
    assert by_task(result) == {
        "pushing": Decision.REGRESSION,
        "opening": Decision.PASSED,
        "mean": Decision.REGRESSION,
    }
    assert (result.decision, result.exit_code) == (Decision.REGRESSION, 1)
    assert len(result.changes) == 20


def test_a_worsening_within_the_tolerance_is_none():
    lenient = replace(SUCCESS, tolerances={"success": Tolerance(0.35)})
    result = judged(candidate(70), lenient)
    assert result.decision is Decision.PASSED  # significant, and tolerated
    assert result.judged[0].p_adjusted < 0.001
    tolerances = {
        "success": Tolerance(0.05),
        "pushing.success": Tolerance(0.35),
        "mean.success": Tolerance(0.2),
    }
    own = replace(SUCCESS, tolerances=tolerances)
    assert judged(candidate(70), own).decision is Decision.PASSED


def test_a_worsening_that_chance_explains_is_inconclusive():
    result = judged(candidate(84))  # six lost: beyond 5 points, p = 0.03 before Holm
    assert result.judged[0].effect.p_value < 0.05 < result.judged[0].p_adjusted
    assert result.decision is Decision.INCONCLUSIVE
    assert result.exit_code == 0
    assert result.episodes_needed > N
    assert judged(candidate(84), replace(SUCCESS, strict=True)).exit_code == 1


def test_few_episodes_per_task_are_enough_together():
    goals = ("pushing", "opening", "pick-up")
    all_won = make_saved({task: values(flags(5, 5)) for task in goals}, "base")
    none_won = make_saved({task: values(flags(0, 5)) for task in goals}, "x")
    result = judged(none_won, GateSettings(metrics=("success",)), all_won)
    expected = dict.fromkeys(goals, Decision.INCONCLUSIVE) | {"mean": Decision.REGRESSION}
    assert by_task(result) == expected
    assert result.exit_code == 1
    assert result_line(result) == "FAIL: worse beyond the tolerance in mean success"
    assert result.next_command == "minitouch-bench replay runs/new pushing/0"


def test_what_has_no_direction_is_shown_and_never_judged():
    more = values(flags(90, N), touch=np.full(N, 900))
    base = make_saved({"pushing": values(flags(90, N))}, "base")
    result = judged(make_saved({"pushing": more}, "x"), GateSettings(), base)
    assert result.decision is Decision.PASSED
    (shown,) = result.unjudged
    assert (shown.task, shown.metric, shown.direction) == ("pushing", "touch_interaction", "")
    assert "not judged: candidate has more" in gate_markdown(result)
    with pytest.raises(UsageError, match="touch_interaction cannot get worse"):
        judged(base, GateSettings(metrics=("touch_interaction",)), base)


def test_a_task_with_other_rules_is_left_out_and_named():
    header = replace(BASELINE.header, task_digests={"opening": "as before", "pushing": "before"})
    changed = replace(header, task_digests={"opening": "as before", "pushing": "now"})
    other = candidate(20)
    result = judged(replace(other, header=changed), baseline=replace(BASELINE, header=header))
    assert by_task(result) == {"opening": Decision.PASSED}
    assert result.left_out == ("pushing",)
    assert result_line(result).endswith("excluded; pushing left out, make the baseline again")


@pytest.mark.parametrize(
    ("pushing", "settings", "line", "command"),
    [
        (70, SUCCESS, "FAIL: worse beyond", "minitouch-bench replay runs/new pushing/70"),
        (84, SUCCESS, "PASS: inconclusive, ", "--output runs/base-"),
        (84, replace(SUCCESS, strict=True), "FAIL: inconclusive, ", "--output runs/base-"),
        (100, SUCCESS, "PASS: a worsening", "minitouch-bench compare runs/base runs/new"),
    ],
)
def test_it_ends_in_pass_or_fail_and_the_command_to_type_next(pushing, settings, line, command):
    result = judged(candidate(pushing, 100), settings)
    console = Console(width=120, record=True, file=io.StringIO())
    show_result(result, console)
    answer, following = console.export_text().strip().splitlines()[-2:]
    assert answer.startswith(line)
    assert following.startswith("next: minitouch-bench ")
    assert command in following
    if result.episodes_needed:
        assert f"--episodes {result.episodes_needed}" in following


def test_an_improvement_passes():
    result = judged(candidate(100, 100))
    assert set(by_task(result).values()) == {Decision.PASSED}


def test_direction_matters_for_each_metric():
    goal = values(flags(N, N), np.full(N, 40), np.full(N, 300))
    base = make_saved({"playing": goal, "pushing": goal})
    rng = np.random.default_rng(0)
    for steps, touch, wrong in ((60, 300, "episode_steps"), (40, 200, "touch_interaction")):
        other = values(
            flags(N, N), rng.normal(steps, 3, N).round(), rng.normal(touch, 3, N).round()
        )
        candidate_run = make_saved({"playing": other, "pushing": other}, "x")
        result = judged(candidate_run, GateSettings(), base)
        failed = [o.effect.metric for o in result.judged if o.decision is Decision.REGRESSION]
        assert failed == [wrong]
    better = values(flags(N, N), rng.normal(20, 3, N).round(), rng.normal(400, 3, N).round())
    result = judged(make_saved({"playing": better, "pushing": better}, "x"), GateSettings(), base)
    assert result.decision is Decision.PASSED


def test_equal_digests_pass_at_once_even_where_few_episodes_prove_nothing():
    few = make_saved({"pushing": values(flags(2, 3))}, "few", digest="same")
    result = judged(replace(few, name="again"), GateSettings(strict=True), few)
    assert result.identical
    assert (result.decision, result.exit_code) == (Decision.PASSED, 0)
    other = judged(replace(few, digest="other"), GateSettings(strict=True), few)
    assert not other.identical
    assert (other.decision, other.exit_code) == (Decision.INCONCLUSIVE, 1)
    assert other.episodes_needed == 73


def test_few_equal_values_do_not_pass_a_mean():
    few = make_saved({"playing": values(flags(0, 9))}, "few")
    enough = make_saved({"playing": values(flags(0, 10))}, "enough")
    assert judged(replace(few, digest="o"), GateSettings(), few).decision is Decision.INCONCLUSIVE
    assert judged(replace(enough, digest="o"), GateSettings(), enough).decision is Decision.PASSED


def test_holm_is_over_everything_that_is_judged():
    result = judged(candidate(82), GateSettings())
    raw = [one.effect.p_value for one in result.judged]
    assert len(raw) == 7
    assert min(one.p_adjusted for one in result.judged) == pytest.approx(7 * min(raw))


def test_metrics_that_no_run_has_are_a_mistake():
    with pytest.raises(UsageError, match="exploration cannot get worse"):
        judged(candidate(70), GateSettings(metrics=("exploration",)))


def test_one_regression_is_enough_and_all_must_pass():
    failed, passed, open_ = Decision.REGRESSION, Decision.PASSED, Decision.INCONCLUSIVE
    assert overall([passed, open_, failed]) is failed
    assert overall([passed, open_]) is open_
    assert overall([passed, passed]) is passed


# What it writes


def test_the_document_says_all():
    document = json.loads(gate_json(judged(candidate(84))))
    assert (document["format"], document["decision"]) == ("minitouch-regression", "inconclusive")
    assert document["exit_code"] == 0
    first = document["judged"][0]
    assert (first["decision"], first["tolerance_as_set"]) == ("inconclusive", "0.05")
    assert first["episodes_needed"] == document["episodes_needed"] > N
    assert document["episodes_used"] is None
    assert document["next_command"].startswith("minitouch-bench evaluate ")


@pytest.mark.parametrize(
    ("pushing", "strict", "failures", "skipped"),
    [(70, False, 2, 0), (84, False, 0, 2), (84, True, 2, 0), (90, False, 0, 0)],
)
def test_junit_has_a_case_per_task_and_metric(pushing, strict, failures, skipped):
    text = gate_junit(judged(candidate(pushing), replace(SUCCESS, strict=strict)))
    root = ElementTree.fromstring(text)
    suite = root.find("testsuite")
    for element in (root, suite):
        assert element.attrib["tests"] == "3"
        assert element.attrib["failures"] == str(failures)
        assert element.attrib["skipped"] == str(skipped)
    cases = suite.findall("testcase")
    assert [(c.attrib["classname"], c.attrib["name"]) for c in cases] == [
        ("minitouch.pushing", "success"),
        ("minitouch.opening", "success"),
        ("minitouch.mean", "success"),
    ]
    assert len(suite.findall("testcase/failure")) == failures
    assert len(suite.findall("testcase/skipped")) == skipped


def test_the_summary_begins_with_the_answer():
    assert gate_markdown(judged(candidate(70))).startswith(
        "## ❌ minitouch-bench FAIL: worse beyond the tolerance in pushing success and mean success"
    )
    page = gate_markdown(judged(candidate(84)))
    assert page.startswith("## ❔ minitouch-bench PASS: inconclusive, ")
    assert gate_markdown(judged(candidate(90))).startswith("## ✅ minitouch-bench PASS: ")
    assert "6 episodes ended in another way" in page


def test_the_screen_shows_every_metric_in_its_width():
    console = Console(width=120, record=True, file=io.StringIO())
    show_result(judged(candidate(70), GateSettings()), console)
    text = console.export_text()
    for wanted in ("Success ↑ (share of episodes)", "Touch-interaction (ticks)", "Mean"):
        assert wanted in text
    assert max(map(len, text.splitlines()[:-2])) <= 120  # the last two stay whole, to be copied


def outside_code(page):
    """The page without its code spans, in which GitHub shows everything as it is."""
    return re.sub(r"(`+)(?!`).*?(?<!`)\1(?!`)", "", page)


def test_hostile_names_are_harmless_everywhere():
    hostile = replace(candidate(70, name=HOSTILE), faults={"pushing/1": HOSTILE})
    result = judge_runs(BASELINE, hostile, (HOSTILE, HOSTILE), SUCCESS)
    page = gate_markdown(result)
    assert "<script>" not in outside_code(page)
    console = Console(width=120, record=True, file=io.StringIO())
    show_result(result, console)
    for text in (page, gate_junit(result), console.export_text(), result.next_command):
        assert "\x1b" not in text
    ElementTree.fromstring(gate_junit(result))
