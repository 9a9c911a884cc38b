from dataclasses import replace

import pytest

from minitouch_bench.episode import Outcome
from minitouch_bench.perturbation import Perturbation
from minitouch_bench.reporting.figures import report_figures, short_names, steps_plot
from minitouch_bench.reporting.labels import RunSection, describe_runs, tasks_in_order


@pytest.mark.parametrize(
    "names",
    [
        ("short", "a name that is much too long for a plot"),
        ("x" * 40 + "one" + "y" * 40, "x" * 40 + "two" + "y" * 40),
        tuple(f"{'x' * 30}{index}{'y' * 30}" for index in range(12)),
    ],
)
def test_names_that_differ_stay_different_and_fit(names, hac):
    short = short_names([RunSection(name, hac) for name in names])
    assert len(set(short)) == len(names)
    assert all(len(name) <= 16 for name in short)
    assert all(one == name for one, name in zip(short, names, strict=True) if len(name) <= 16)


def test_histograms_stack_to_100_percent_on_one_axis(hac):
    def ended(outcome, *steps):
        return [replace(hac.rows[0], task="pushing", outcome=outcome, steps=one) for one in steps]

    limit = ended(Outcome.POLICY_FAULT, 200)
    panels = {"a": [*ended(Outcome.SUCCESS, 3, 3, 12), *limit], "b": limit * 2}
    first, second = steps_plot("pushing", panels).charts
    assert first.y == second.y
    assert first.y.high >= 100
    bars = [(mark.tone, *box) for mark in first.marks for box in mark.boxes]
    assert sum(top - bottom for _, _, bottom, _, top in bars) == pytest.approx(100)
    assert [tone for tone, *_ in bars] == ["success", "success", "fault"]
    assert bars[-1][1] > 200  # a bar of its own behind 190-199


def test_true_forces_are_told_from_those_that_a_policy_was_given(hac):
    plan = replace(hac.plan, conditions=Perturbation(without=("forces",)))
    numb = replace(hac, header=replace(hac.header, plan=plan))
    figures = [report_figures(describe_runs([run]), tasks_in_order([run])) for run in (hac, numb)]
    texts = [one.text for found in figures for one in found if one.key == "forces"]
    assert ["given others: hac-seed1" in text for text in texts] == [False, True]
