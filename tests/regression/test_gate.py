import io
import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from rich.console import Console

from minitouch_bench.errors import UsageError
from minitouch_bench.regression.documents import to_text, verdict_document
from minitouch_bench.regression.gate import Ruling, judge_runs, overall
from minitouch_bench.regression.junit import verdict_junit
from minitouch_bench.regression.markdown import verdict_markdown
from minitouch_bench.regression.terminal import show_verdict
from minitouch_bench.regression.tolerances import GateSettings, Tolerance
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


def by_task(verdict):
    return {one.effect.task: one.ruling for one in verdict.judgements}


def test_a_clear_worsening_is_a_regression():
    verdict = judged(candidate(70))
    assert by_task(verdict) == {"pushing": Ruling.REGRESSION, "opening": Ruling.PASSED}
    assert (verdict.ruling, verdict.exit_code) == (Ruling.REGRESSION, 1)
    assert len(verdict.changes) == 20


def test_a_worsening_within_the_tolerance_is_none():
    lenient = replace(SUCCESS, tolerances={"success": Tolerance(0.35)})
    verdict = judged(candidate(70), lenient)
    assert verdict.ruling is Ruling.PASSED  # significant, and tolerated
    assert verdict.judgements[0].p_value < 0.001
    own = replace(
        SUCCESS, tolerances={"success": Tolerance(0.05), "pushing.success": Tolerance(0.35)}
    )
    assert judged(candidate(70), own).ruling is Ruling.PASSED


def test_a_worsening_that_chance_explains_is_inconclusive():
    verdict = judged(candidate(84))  # six lost: beyond 5 points, p = 0.03 before Holm
    assert verdict.judgements[0].effect.p_value < 0.05 < verdict.judgements[0].p_value
    assert verdict.ruling is Ruling.INCONCLUSIVE
    assert verdict.exit_code == 0
    assert verdict.needed > N
    assert judged(candidate(84), replace(SUCCESS, strict=True)).exit_code == 1


def test_an_improvement_passes():
    verdict = judged(candidate(100, 100))
    assert set(by_task(verdict).values()) == {Ruling.PASSED}


def test_direction_matters_for_each_metric():
    base = make_saved({"pushing": values(flags(N, N), np.full(N, 40), np.full(N, 300))})
    rng = np.random.default_rng(0)
    for steps, touch, wrong in ((60, 300, "episode_steps"), (40, 200, "touch_interaction")):
        other = values(
            flags(N, N), rng.normal(steps, 3, N).round(), rng.normal(touch, 3, N).round()
        )
        verdict = judged(make_saved({"pushing": other}, "x"), GateSettings(), base)
        failed = [o.effect.metric for o in verdict.judgements if o.ruling is Ruling.REGRESSION]
        assert failed == [wrong]
    better = values(flags(N, N), rng.normal(20, 3, N).round(), rng.normal(400, 3, N).round())
    verdict = judged(make_saved({"pushing": better}, "x"), GateSettings(), base)
    assert verdict.ruling is Ruling.PASSED


def test_equal_digests_pass_at_once_even_where_few_episodes_prove_nothing():
    few = make_saved({"pushing": values(flags(2, 3))}, "few", digest="same")
    verdict = judged(replace(few, name="again"), GateSettings(strict=True), few)
    assert verdict.identical
    assert (verdict.ruling, verdict.exit_code) == (Ruling.PASSED, 0)
    other = judged(replace(few, digest="other"), GateSettings(strict=True), few)
    assert not other.identical
    assert (other.ruling, other.exit_code) == (Ruling.INCONCLUSIVE, 1)
    assert other.needed == 73


def test_few_equal_values_do_not_pass_a_mean():
    few = make_saved({"playing": values(flags(0, 9))}, "few")
    enough = make_saved({"playing": values(flags(0, 10))}, "enough")
    assert judged(replace(few, digest="o"), GateSettings(), few).ruling is Ruling.INCONCLUSIVE
    assert judged(replace(enough, digest="o"), GateSettings(), enough).ruling is Ruling.PASSED


def test_holm_is_over_everything_that_is_judged():
    verdict = judged(candidate(82), GateSettings())
    raw = [one.effect.p_value for one in verdict.judgements]
    assert len(raw) == 6
    assert min(one.p_value for one in verdict.judgements) == pytest.approx(6 * min(raw))


def test_metrics_that_no_run_has_are_a_mistake():
    with pytest.raises(UsageError, match="none of the metrics exploration"):
        judged(candidate(70), GateSettings(metrics=("exploration",)))


def test_one_regression_is_enough_and_all_must_pass():
    failed, passed, open_ = Ruling.REGRESSION, Ruling.PASSED, Ruling.INCONCLUSIVE
    assert overall([passed, open_, failed]) is failed
    assert overall([passed, open_]) is open_
    assert overall([passed, passed]) is passed


# What it writes


def test_the_document_says_all():
    document = json.loads(to_text(verdict_document(judged(candidate(84)))))
    assert (document["format"], document["verdict"]) == ("minitouch-regression", "inconclusive")
    assert document["exit_code"] == 0
    assert document["judgements"][0]["judgement"] == "inconclusive"
    assert document["judgements"][0]["needed_episodes"] == document["needed_episodes"] > N
    assert document["judgements"][0]["tolerance_as_set"] == "0.05"
    assert document["sequential"] is None


@pytest.mark.parametrize(
    ("pushing", "strict", "failures", "skipped"),
    [(70, False, 1, 0), (84, False, 0, 1), (84, True, 1, 0), (90, False, 0, 0)],
)
def test_junit_has_a_case_a_task_and_metric(pushing, strict, failures, skipped):
    text = verdict_junit(judged(candidate(pushing), replace(SUCCESS, strict=strict)))
    root = ElementTree.fromstring(text)
    suite = root.find("testsuite")
    for element in (root, suite):
        assert element.attrib["tests"] == "2"
        assert element.attrib["failures"] == str(failures)
        assert element.attrib["skipped"] == str(skipped)
    cases = suite.findall("testcase")
    assert [(c.attrib["classname"], c.attrib["name"]) for c in cases] == [
        ("minitouch.pushing", "success"),
        ("minitouch.opening", "success"),
    ]
    assert len(suite.findall("testcase/failure")) == failures
    assert len(suite.findall("testcase/skipped")) == skipped


def test_the_summary_begins_with_the_answer():
    assert verdict_markdown(judged(candidate(70))).startswith(
        "## ❌ minitouch-bench: regression: worse beyond the tolerance in pushing success"
    )
    page = verdict_markdown(judged(candidate(84)))
    assert page.startswith("## ❔ minitouch-bench: inconclusive, needs ")
    assert verdict_markdown(judged(candidate(90))).startswith(
        "## ✅ minitouch-bench: no regression"
    )
    assert "6 episodes ended in another way" in page


def test_the_screen_ends_with_the_answer():
    console = Console(width=120, record=True, file=io.StringIO())
    show_verdict(judged(candidate(70)), console)
    text = console.export_text()
    assert text.strip().endswith("regression: worse beyond the tolerance in pushing success")
    assert "Success ↑ (share of episodes)" in text
    assert max(map(len, text.splitlines())) <= 120


def outside_code(page):
    """The page without its code spans, in which GitHub shows everything as it is."""
    return re.sub(r"(`+)(?!`).*?(?<!`)\1(?!`)", "", page)


def test_hostile_names_are_harmless_everywhere():
    hostile = replace(candidate(70, name=HOSTILE), faults={"pushing/1": HOSTILE})
    verdict = judge_runs(BASELINE, hostile, (HOSTILE, HOSTILE), SUCCESS)
    page = verdict_markdown(verdict)
    assert "<script>" not in outside_code(page)
    for text in (page, verdict_junit(verdict)):
        assert "\x1b" not in text
    ElementTree.fromstring(verdict_junit(verdict))
