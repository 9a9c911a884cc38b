from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from minitouch_bench.comparison.gate import (
    LARGEST_ALPHA,
    Decision,
    GateSettings,
    Tolerance,
    judge_runs,
)
from minitouch_bench.comparison.gate_report import (
    gate_junit,
    gate_markdown,
    result_line,
    show_result,
)
from minitouch_bench.errors import UsageError
from minitouch_bench.perturbation import Perturbation
from tests.comparison.pairs import (
    flags,
    make_saved,
    outside_code,
    shown,
    values,
    with_actions,
    with_header,
)
from tests.reporting.conftest import HOSTILE

N = 100
BASELINE = make_saved({"pushing": values(flags(90, N)), "opening": values(flags(95, N))}, "base")
STANDARD = GateSettings()


def candidate(pushing, opening=95, name="candidate"):
    tasks = {"pushing": values(flags(pushing, N)), "opening": values(flags(opening, N))}
    return make_saved(tasks, name)


def judged(other, settings=STANDARD, baseline=BASELINE):
    return judge_runs(baseline, other, ("runs/base", "runs/new"), settings)


def worse_in(result):
    return [(one.effect.task, one.effect.metric) for one in result.per_task if one.is_worse]


# The decision


def test_a_clear_worsening_is_a_regression_and_the_tasks_say_where():
    result = judged(candidate(70))
    assert (result.decision, result.exit_code) == (Decision.REGRESSION, 1)
    assert result.endpoint.p_value == pytest.approx(0.5**20)  # one-sided: 20 lost, none won
    effect = result.endpoint.effect
    assert (effect.task, effect.metric, effect.difference.count) == ("mean", "success", 2 * N)
    assert worse_in(result) == [("pushing", "success"), ("pushing", "episode_steps")]
    assert len(result.changes) == 20
    raw = min(one.effect.p_value for one in result.per_task) / 2
    tested = len(result.per_task)  # adjusted by Holm over every metric of every task
    assert {one.effect.task for one in result.per_task} == {"pushing", "opening"}
    assert min(one.p_adjusted for one in result.per_task) == pytest.approx(tested * raw)


def test_an_improvement_and_a_worsening_within_the_tolerance_are_none():
    better = judged(candidate(100, 100))
    assert (better.decision, better.exit_code) == (Decision.NO_REGRESSION, 0)
    assert better.endpoint.p_value == 1.0
    result = judged(candidate(70), GateSettings(tolerance=Tolerance(0.2)))
    assert result.decision is Decision.NO_REGRESSION
    assert result.endpoint.p_value < 0.001  # significant, and tolerated


FEW = {task: values(flags(10, 10)) for task in ("pushing", "opening")}


def few(lost):
    tasks = FEW | {"pushing": values(flags(10 - lost, 10))}
    return make_saved(tasks, "few")


@pytest.mark.parametrize(
    ("lost", "options", "code"),
    [
        (0, {}, 0),  # 20 episodes do not exclude a loss of 5 points
        (0, {"strict": True}, 5),
        (4, {}, 5),  # 20 points, p = 0.06: worse, perhaps by chance
        (4, {"lenient": True}, 0),
    ],
)
def test_what_chance_explains_is_not_enough_and_fails_where_it_is_beyond(lost, options, code):
    result = judged(few(lost), GateSettings(**options), make_saved(FEW, "base"))
    assert (result.decision, result.exit_code) == (Decision.NOT_ENOUGH, code)
    assert result.endpoint.episodes_needed > 10
    assert result.endpoint.is_beyond == (lost == 4)
    assert worse_in(result) == []
    assert {one.p_adjusted for one in result.per_task} == {None}
    assert result_line(result).startswith("not enough episodes")
    assert f"{result.endpoint.episodes_needed} episodes per task" in result_line(result)


def test_equal_digests_are_no_regression_even_where_few_episodes_prove_nothing():
    base = make_saved({"pushing": values(flags(2, 3))}, "few", digest="same")
    result = judged(replace(base, name="again"), GateSettings(strict=True), base)
    assert result.identical
    assert (result.decision, result.exit_code) == (Decision.NO_REGRESSION, 0)
    other = judged(replace(base, digest="other"), GateSettings(strict=True), base)
    assert not other.identical
    assert (other.decision, other.exit_code) == (Decision.NOT_ENOUGH, 5)
    assert other.endpoint.episodes_needed == 73
    endless = judged(replace(base, digest="other"), GateSettings(tolerance=Tolerance(0.0)), base)
    assert "10,000" in result_line(endless)


# What decides


def test_playing_is_judged_by_its_touch_share_unless_a_task_has_a_goal(tmp_path):
    touched = replace(values(flags(0, N)), touch_steps=np.full(N, 150))
    rubbed = replace(touched, touch_steps=np.full(N, 50))
    goal = values(flags(N, N))
    alone = judged(make_saved({"playing": rubbed}, "x"), baseline=make_saved({"playing": touched}))
    assert (alone.endpoint.effect.task, alone.endpoint.effect.metric) == ("playing", "touch_share")
    assert alone.decision is Decision.REGRESSION
    base, other = ({"playing": own, "pushing": goal} for own in (touched, rubbed))
    both = judged(make_saved(other, "x"), baseline=make_saved(base))
    assert (both.endpoint.effect.task, both.endpoint.effect.metric) == ("pushing", "success")
    assert both.decision is Decision.NO_REGRESSION
    lost = make_saved({**other, "pushing": values(flags(0, N))}, "x")  # a replay is of what decides
    result = judged(
        with_actions(lost, tmp_path), GateSettings(metric="touch_share"), make_saved(base)
    )
    assert (result.decision, result.endpoint.tasks) == (Decision.REGRESSION, ("playing",))
    assert result.next_command == "minitouch-bench compare runs/base runs/new"
    assert "replay" in judged(with_actions(lost, tmp_path), baseline=make_saved(base)).next_command


def test_another_metric_can_decide():
    goal = values(flags(N, N), np.full(N, 40))
    rng = np.random.default_rng(0)
    slower = values(flags(N, N), rng.normal(60, 3, N).round())
    faster = values(flags(N, N), rng.normal(20, 3, N).round())
    base = make_saved({"pushing": goal, "opening": goal})
    for own, decision in ((slower, Decision.REGRESSION), (faster, Decision.NO_REGRESSION)):
        other = make_saved({"pushing": own, "opening": own}, "x")
        assert judged(other, baseline=base).decision is Decision.NO_REGRESSION  # success
        result = judged(other, GateSettings(metric="episode_steps"), base)
        assert result.decision is decision
        assert result.endpoint.tasks == ("pushing", "opening")
        assert result.endpoint.tolerance == pytest.approx(4.0)


def test_a_metric_that_decides_nothing_is_a_mistake():
    for metric, why in (
        ("exploration", "exploration episodes are missing: POLICY plays none"),
        ("touch_interaction", "touch_interaction cannot get worse"),
    ):
        with pytest.raises(UsageError, match=why):
            judged(candidate(70), GateSettings(metric=metric))
    unequal = make_saved({"pushing": values(flags(3, 3)), "opening": values(flags(1, 1))})
    with pytest.raises(UsageError, match=r"\(pushing 3, opening 1\): make the baseline again"):
        judged(unequal, baseline=unequal)


def test_other_conditions_are_refused():
    blind = with_header(candidate(90), conditions=Perturbation(without=("vision",)))
    with pytest.raises(UsageError, match=r"conditions .*vision.*standard"):
        judged(blind)
    assert judged(blind, baseline=with_header(BASELINE, conditions=blind.plan.conditions))


# What it writes


def test_a_run_without_actions_has_no_command_that_replays_it(tmp_path):
    for directory in (None, tmp_path):
        result = judged(replace(candidate(70), directory=directory))
        assert result.decision is Decision.REGRESSION
        assert {change.replay for change in result.changes} == {""}
        assert result.next_command == "minitouch-bench compare runs/base runs/new"
        assert "replay" not in gate_markdown(result) + gate_junit(result)


def junit_suite(result):
    root = ElementTree.fromstring(gate_junit(result))
    suite = root.find("testsuite")
    for element in (root, suite):
        assert int(element.attrib["tests"]) == len(suite.findall("testcase"))
        for counted, found in (("failures", "failure"), ("skipped", "skipped")):
            assert int(element.attrib[counted]) == len(suite.findall(f"testcase/{found}"))
    return suite


def case_names(suite):
    return [(case.attrib["classname"], case.attrib["name"]) for case in suite.findall("testcase")]


@pytest.mark.parametrize(
    ("other", "lenient", "kind"),
    [(few(10), False, "failure"), (few(4), False, "failure"), (few(4), True, "skipped")],
)
def test_junit_has_a_case_for_the_answer_and_one_for_each_metric(other, lenient, kind):
    result = judged(other, GateSettings(lenient=lenient), make_saved(FEW, "base"))
    suite = junit_suite(replace(result, wall_s=12.5))
    first, *others = suite.findall("testcase")
    assert case_names(suite)[0] == ("minitouch.gate", "mean success")
    assert first.find(kind) is not None
    if result.decision is Decision.REGRESSION:
        assert sum(case.find("failure") is not None for case in others) == len(worse_in(result)) > 0
    else:
        assert all(case.find("skipped") is not None for case in others)
    assert suite.attrib["time"] == first.attrib["time"] == "12.500"
    assert not any("time" in case.attrib for case in others)


def test_junit_names_a_suite_that_is_not_the_usual_one():
    base, other = (with_header(make_saved(FEW, name), suite="smoke") for name in ("base", "other"))
    names = case_names(junit_suite(judged(other, GateSettings(), base)))
    assert names[0] == ("minitouch.smoke.gate", "mean success")
    assert ("minitouch.smoke.pushing", "success") in names


@pytest.mark.parametrize(
    ("tasks", "n"), [(("pushing",), 4), (("pushing", "opening"), 100), (("playing",), 100)]
)
def test_the_names_of_junit_s_cases_are_unique_and_do_not_depend_on_the_outcome(tasks, n):
    won, lost = values(flags(n, n)), replace(values(flags(0, n)), touch_steps=np.zeros(n, int))
    base = make_saved(dict.fromkeys(tasks, won), "base")
    found = [
        judged(make_saved(dict.fromkeys(tasks, own), name), GateSettings(strict=strict), base)
        for own, name in ((won, "base"), (won, "other"), (lost, "lost"))
        for strict in (False, True)
    ]
    assert len({result.decision for result in found}) >= 2
    names = {tuple(case_names(junit_suite(result))) for result in found}
    assert len(names) == 1
    (one,) = names
    assert len(set(one)) == len(one) > len(tasks)


def test_hostile_names_are_harmless_everywhere():
    hostile = replace(candidate(70, name=HOSTILE), faults={"pushing/1": HOSTILE})
    result = judge_runs(BASELINE, hostile, (HOSTILE, HOSTILE), STANDARD)
    page, junit = gate_markdown(result), gate_junit(result)
    assert "<script>" not in outside_code(page)
    assert "\x1b" not in page + junit + shown(show_result, result) + result.next_command
    ElementTree.fromstring(junit)


# Its settings


@pytest.mark.parametrize(
    "change",
    [
        {"alpha": 0.0},
        {"alpha": LARGEST_ALPHA * 2},
        {"metric": "flying"},
        {"tolerance": Tolerance(1.0)},  # of a share
        {"tolerance": Tolerance(float("nan"))},
        {"strict": True, "lenient": True},
    ],
)
def test_a_value_without_meaning_is_refused_by_name(change):
    name = "strict" if "strict" in change else [*change][-1]
    with pytest.raises(UsageError, match=name):
        GateSettings(**change)


def test_a_tolerance_is_a_number_or_a_percentage():
    assert Tolerance.parse("0.05") == Tolerance(0.05)
    assert Tolerance.parse(3) == Tolerance(3.0)
    assert Tolerance.parse(" 10% ") == Tolerance(0.1, relative=True)
    for other in ("", "success=0.1", "%", "5 points"):
        with pytest.raises(UsageError, match="percentage"):
            Tolerance.parse(other)
