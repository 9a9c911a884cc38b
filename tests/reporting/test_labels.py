import shlex
from dataclasses import replace

import pytest

from minitouch_bench.episode import IN_MEMORY
from minitouch_bench.metrics.intervals import Estimate
from minitouch_bench.perturbation import Perturbation
from minitouch_bench.protocol.limits import PolicyLimits
from minitouch_bench.reporting.labels import (
    PAPER_METHODS,
    PAPER_TASKS,
    estimate_cell,
    paper_cell,
    paper_value,
    reproduce_command,
    run_labels,
    run_names,
)
from minitouch_bench.reporting.report import build_report, show_report
from minitouch_bench.runs.plan import PlannedObjects
from tests.comparison.pairs import shown, with_header
from tests.reporting.synthetic import make_run, save

TABLE_4 = {
    "exploration": "0.403 0.181 0.077  0.669 0.564 0.380  0.063 0.013 0.005",
    "success": "0.733 0.710 0.582  0.983 0.921 0.875  0.891 0.593 0.450",
    "episode_steps": "57.84 55.20 97.51  23.34 23.54 37.92  30.54 52.29 89.88",
    "touch_interaction": "247.79 227.75 206.02  600.1 411.43 194.22  980.7 894.5 725.1  "
    "388.15 312.0 124.5",
}
"""The supplement's values: pushing, opening, pick-up, playing."""


@pytest.mark.parametrize("metric", TABLE_4)
def test_the_paper_s_values_are_those_of_table_4(metric):
    places = [(task, metric, method) for task in PAPER_TASKS for method in PAPER_METHODS]
    assert [value for place in places if (value := paper_value(*place))] == TABLE_4[metric].split()
    numbers = {paper_cell(*place).sort_key for place in places}
    assert (numbers == {None}) == (metric == "touch_interaction")  # in a unit of the paper's own


def test_a_value_carries_its_interval_and_how_it_was_made():
    cell = estimate_cell("success", Estimate(0.97, 0.9161, 0.9897, 100, "wilson"), mark="0.733")
    assert str(cell) == "0.970 [0.916, 0.990]"
    assert "100 episodes" in cell.title
    assert ['M97 3h0"' in cell.gauge, 'class="mark" d="M73.3 -2' in cell.gauge] == [True, True]


def test_runs_of_one_policy_are_told_apart(hac):
    again = replace(hac, name="second")
    assert run_names([hac, again]) == ("hac-seed1 (hac-seed1)", "hac-seed1 (second)")
    assert run_names([hac, hac])[1] == "hac-seed1 (hac-seed1) #2"
    assert run_names([hac]) == ("hac-seed1",)
    plan = replace(hac.plan, episodes=100)
    blind = replace(plan, conditions=Perturbation(without=("vision",)))
    usual, changed = (replace(hac, header=replace(hac.header, plan=one)) for one in (plan, blind))
    assert run_names([usual, changed]) == ("hac-seed1", "hac-seed1 (without vision)")


def test_a_run_in_the_dark_is_labeled_and_not_beside_the_paper(hac):
    tasks = ("opening", "pick-up")
    run = save(make_run(tasks=tasks, episodes=5, exploration=False), "one")
    dark, lit = (
        with_header(run, suite="dark", conditions=Perturbation(light=light))
        for light in (None, (1.0, 1.0))
    )
    assert "light off: every image is black" in run_labels(dark)
    assert not any("light off" in label for label in run_labels(lit))
    assert run_names([dark, hac]) == (
        "hac-seed1 (suite dark, opening, pick-up, 5 episodes)",
        "hac-seed1 (suite table4, 20 episodes)",
    )
    text = shown(show_report, build_report([dark]))
    assert "light off" in text
    assert "(paper)" not in text
    assert "(paper)" in shown(show_report, build_report([lit]))


def test_a_policy_whose_actions_are_mostly_clipped_is_said_to_be_one(scripted):
    rows = [replace(row, clipped_actions=row.steps) for row in scripted.rows]
    assert "100% of its actions were outside -1 to 1, and clipped" in run_labels(
        replace(scripted, rows=tuple(rows))
    )
    assert not any("clipped" in label for label in run_labels(scripted))


def test_a_run_is_repeated_by_its_suite_and_what_differs_from_it(hac, scripted):
    plan = replace(hac.plan, episodes=100)
    assert reproduce_command(replace(hac.header, plan=plan)) == (
        "minitouch-bench evaluate checkpoints/hac-seed1.safetensors --suite table4 "
        "--exploration e.safetensors"
    )
    header = replace(scripted.header, plan=replace(scripted.plan, seed=7))
    assert reproduce_command(header).endswith("--tasks playing,pushing --episodes 5 --seed 7")


def test_limits_and_isolation_are_those_of_the_run(hac, scripted):
    plan = replace(hac.plan, limits=PolicyLimits(act_timeout_s=2.5, episode_timeout_s=60.0))
    limited = replace(hac.header, plan=plan, isolation="process", official=False)
    command = reproduce_command(limited)
    assert "--episodes 20 --act-timeout 2.5 --episode-timeout 60 --exploration" in command
    assert command.endswith("--isolation process --trust")
    policy = replace(scripted.header.policy, kind="scripted")  # which runs there in any case
    beside = replace(scripted.header, policy=policy, isolation="none")
    for header in (beside, replace(beside, exploration=hac.header.exploration)):
        assert "--isolation" not in reproduce_command(header)
    remote = replace(hac.header.policy, kind="remote")
    chosen = replace(hac.header, policy=remote, isolation="process")  # of the exploration policy
    assert reproduce_command(chosen).endswith("--isolation process --trust")
    alone = replace(chosen, exploration=None)
    assert "--isolation" not in reproduce_command(alone)
    assert "--isolation none" in reproduce_command(replace(alone, isolation="none"))
    explored = replace(hac.header.exploration, kind="factory")
    assert reproduce_command(replace(hac.header, exploration=explored)).endswith("--trust")


def test_no_command_repeats_what_only_python_can_name(hac):
    policy = replace(hac.header.policy, kind=IN_MEMORY)
    assert reproduce_command(replace(hac.header, policy=policy)) == ""
    objects = PlannedObjects.of(["shape-0001", "shape-0002"])
    plan = replace(hac.plan, objects=objects)
    assert reproduce_command(replace(hac.header, plan=plan)) == ""


def test_a_source_cannot_add_a_command(hac):
    policy = replace(hac.header.policy, source="x.pt; rm -r y\nls", kind="factory")
    words = shlex.split(reproduce_command(replace(hac.header, policy=policy)))
    assert words[2] == "x.pt; rm -r y ls"
    assert words[-1] == "--trust"
