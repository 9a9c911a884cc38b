"""What several runs show together: over seeds, and over training steps."""

import hashlib
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.conditions import Conditions
from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.intervals import wilson
from minitouch_bench.reporting.curve import ONE_TRAINING, curve_csv, label_curve, make_curve
from minitouch_bench.reporting.labels import RunOrigin, describe_runs
from minitouch_bench.reporting.long_frame import find_row
from minitouch_bench.reporting.over_runs import (
    interquartile_mean,
    label_methods,
    performance_profile,
    resample_scores,
)
from minitouch_bench.reporting.report import AcrossRuns, build_report
from minitouch_bench.reporting.writers import to_html, to_markdown
from tests.reporting.synthetic import make_run, save

BLIND = {"conditions": Conditions(without=("vision",))}


def make(name, skill=0.5, seed=0, tasks=("pushing", "opening"), policy="", **plan):
    run = make_run(name, tasks=tasks, episodes=10, skill=skill, seed=seed, exploration=False)
    digest = hashlib.sha256((policy or name).encode()).hexdigest()
    identity = replace(run.header.policy, digest=digest)
    header = replace(run.header, policy=identity, plan=replace(run.header.plan, **plan))
    return save(replace(run, header=header), name)


@pytest.fixture(scope="module")
def seeds():
    """Two seeds of one method, and one run of which nothing is known."""
    runs = [make("a", 0.9), make("b", 0.8, 1), make("c", 0.2, 2)]
    return runs, (RunOrigin("hac", 5000), RunOrigin("hac", 5000), RunOrigin())


def test_seeds_of_one_method_are_one_row(seeds):
    runs, origins = seeds
    labels = label_methods(describe_runs(runs), origins)
    assert [(one.method, one.seed) for one in labels] == [("hac", 0), ("hac", 1), ("c", 0)]
    longer = (RunOrigin("hac", 5000), RunOrigin("hac", 9000), RunOrigin())
    names = [one.method for one in label_methods(describe_runs(runs), longer)]
    assert names == ["hac, 5,000 steps, table4", "hac, 9,000 steps, table4", "c"]


def test_two_runs_of_one_policy_are_not_two_seeds():
    runs = [make("a"), make("b", seed=1, policy="a"), make("c", tasks=("playing",), policy="a")]
    labels = label_methods(describe_runs(runs), (RunOrigin("hac", 5000),) * 3)
    assert Counter(one.method for one in labels) == {"hac": 2, "b": 1}


def test_a_run_that_is_called_as_a_method_is_not_a_seed_of_it():
    runs = [make("a"), make("b", seed=1), make("c", seed=2)]
    sections = describe_runs(runs, ("a", "b", "hac"))
    labels = label_methods(sections, (*[RunOrigin("hac", 5000)] * 2, RunOrigin()))
    assert [(one.method, one.seed) for one in labels] == [("hac", 0), ("hac", 1), ("hac (run)", 0)]


def test_a_task_with_more_runs_does_not_count_for_more(seeds):
    runs, origins = seeds
    more = [*runs, make("d", tasks=("pushing",))]
    across = AcrossRuns((*origins, RunOrigin("hac", 5000)))
    assert build_report(more, across=across).over_runs.tables == ()


def test_a_curve_does_not_mix_conditions():
    altered = make("b_2000_steps", conditions=Conditions(without=("forces",)))
    runs = [make("a_1000_steps"), make("b_1000_steps"), make("a_2000_steps"), altered]
    labels = label_curve(runs, (RunOrigin("hac"),) * 4)
    assert Counter((one.method, one.steps) for one in labels) == {
        ("hac", 1000): 2,
        ("hac", 2000): 1,
        ("hac, without forces", 2000): 1,
    }


def test_another_run_of_a_policy_is_another_line_of_a_curve():
    plans = ({}, {"suite": "novel-shapes"}, {"seed": 1})
    runs = [make(f"{n}", policy="a", **plan) for n, plan in enumerate(plans)]
    runs += [make("b"), make("3", policy="c")]
    labels = label_curve(runs, (RunOrigin("hac"),) * 5, (10, 10, 10, 10, 20))
    assert [(one.method, one.seed) for one in labels] == [
        ("hac, table4", 0),
        ("hac, novel-shapes", 0),
        ("hac, table4, 2", 0),
        ("hac, table4", 1),
        ("hac, table4", 0),
    ]
    of_names = label_curve(runs, (RunOrigin(),) * 5, (10, 10, 10, 10, 20), ("x",) * 5)
    assert [one.method for one in of_names] == ["x", "x, 1", "x, 2", "x", "x"]


def test_a_report_of_several_runs_has_their_interquartile_means(seeds):
    runs, origins = seeds
    report = build_report(runs, across=AcrossRuns(origins))
    (table,) = report.over_runs.tables
    assert [row.heads for row in table.rows] == [("hac",), ("c",)]
    assert [str(row.cells[2]) for row in table.rows] == ["4", "2"]
    assert [str(row.cells[3]) for row in table.rows] == ["training seeds", "episodes"]
    titles = [row.cells[0].title for row in table.rows]
    assert titles[0] == "4 scores, 95 % interval: bootstrap of scores over training seeds"
    assert titles[1] == "2 scores, 95 % interval: bootstrap of scores over episodes"
    assert "## Over tasks and seeds" in to_markdown(report)
    assert to_html(report).count('id="over-tasks-and-seeds"') == 1
    assert build_report(runs[:1]).over_runs.tables == ()


def test_tasks_that_not_all_methods_have_are_left_out():
    runs = [make("a"), make("b", tasks=("pushing", "playing"))]
    assert build_report(runs).over_runs.tables == ()  # one score each says no more than Table 4


def test_steps_and_trainings_are_read_off_the_policies_names():
    names = ("hac_20000_steps", "hac_10000_steps", "rnd-step-10000", "rnd-step-20000")
    runs = [make(name) for name in names]
    curve = make_curve(label_curve(runs, (RunOrigin(),) * 4), runs)
    found = [*dict.fromkeys(zip(curve["method"], curve["steps"], strict=True))]
    assert found == [("hac", 10000), ("hac", 20000), ("rnd", 10000), ("rnd", 20000)]


@pytest.mark.parametrize(
    ("methods", "conditions", "trainings"),
    [
        (("", ""), {}, (ONE_TRAINING, ONE_TRAINING)),
        (("", ""), BLIND, (ONE_TRAINING, f"{ONE_TRAINING}, without vision")),
        (("hac", "rnd"), {}, ("hac", "rnd")),
        (("hac", ""), {}, ("hac", "late")),
    ],
)
def test_steps_that_are_given_win_and_different_names_alone_are_one_training(
    methods, conditions, trainings
):
    runs = [make("early_7_steps"), make("late_8_steps", **conditions)]
    labels = label_curve(runs, [*map(RunOrigin, methods)], (100, 200))
    assert [(one.method, one.steps) for one in labels] == [*zip(trainings, (100, 200), strict=True)]


def test_runs_of_one_training_after_the_same_steps_are_seeds():
    runs = [make("a", 0.9), make("b", 0.5, 1), make("c", 0.2, 2)]
    labels = label_curve(runs, (RunOrigin(),) * 3, (10, 10, 20), ("x", "x", "x"))
    assert [(one.steps, one.seed) for one in labels] == [(10, 0), (10, 1), (20, 0)]
    curve = make_curve(labels, runs)
    found = find_row(curve, steps=10, task="pushing")
    one, other = (run.summary.tasks[0].estimates["success"] for run in runs[:2])
    assert found.value == pytest.approx((one.value + other.value) / 2)
    assert found.low < found.value < found.high
    assert found.count == 2
    rows = curve_csv(curve).splitlines()
    assert rows[0] == "training,training_steps,task,metric,value,low,high,count,method"
    assert len(rows) == 1 + 2 * 2


@pytest.mark.parametrize(
    ("steps", "names", "what"),
    [
        ((), None, "nothing says after how many"),
        ((10,), None, "--steps has 1 values for 2 runs"),
        ((10, 20), ("a",), "--names has 1 values"),
        ((10, 10), None, "different numbers of steps"),
    ],
)
def test_a_curve_that_cannot_be_drawn(steps, names, what):
    with pytest.raises(UsageError, match=what):
        label_curve([make("a"), make("b")], (RunOrigin(), RunOrigin()), steps, names)


def test_the_curve_stands_in_the_report():
    runs = [make("hac_10_steps"), make("hac_20_steps", 0.8)]
    report = build_report(runs, across=AcrossRuns(curve=True))
    assert "## Learning curve" in to_markdown(report)
    assert 'id="learning-curve"' in to_html(report)


RATES = ((0.9, 0.8, 0.2), (0.5, 0.6, 0.55), (0.1, 0.3, 0.7))


def scores(rates=RATES, episodes=100, seed=0):
    by_task = [[wilson(round(rate * episodes), episodes) for rate in own] for own in rates]
    return resample_scores(by_task, np.random.default_rng(seed))


def test_the_interquartile_mean_is_that_of_the_middle_half():
    found = interquartile_mean(scores())
    middle = sorted(rate for own in RATES for rate in own)[2:-2]
    assert found.value == pytest.approx(np.mean(middle))
    assert found.low < found.value < found.high
    assert found.count == 9
    assert "training seeds" in found.method


def test_the_same_generator_gives_the_same_numbers():
    one_run = [own[:1] for own in RATES]
    first, again, other = (interquartile_mean(scores(one_run, seed=seed)) for seed in (3, 3, 4))
    assert first == again
    assert first != other


@pytest.mark.parametrize("rates", [((0.0,), (0.0,)), ((1.0, 1.0), (1.0, 1.0))])
def test_no_interval_has_a_width_of_0(rates):
    found = interquartile_mean(scores(rates, episodes=20))
    assert 0.01 < found.high - found.low < 0.3
    assert found.low <= found.value <= found.high


def test_the_interval_of_one_run_covers_its_mean_success_in_95_of_100_cases():
    truth, rng = np.array([0.2, 0.5, 0.8]), np.random.default_rng(1)
    hits = 0
    for _ in range(100):
        runs = [[wilson(int(rng.binomial(50, rate)), 50)] for rate in truth]
        found = interquartile_mean(resample_scores(runs, rng))
        hits += found.low <= truth.mean() <= found.high
    assert hits >= 89


def test_the_profile_falls_from_all_to_none_inside_its_interval():
    thresholds = np.linspace(0, 1, 21)
    share, low, high = performance_profile(scores(), thresholds)
    assert share[0] == 1
    assert share[-1] == 0
    assert share[10] == pytest.approx(5 / 9)  # above 0.5
    assert (np.diff(share) <= 0).all()
    assert (low <= share).all()
    assert (share <= high).all()
