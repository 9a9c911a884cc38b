import shutil
from dataclasses import replace

import pytest
import typer

from minitouch_bench.commands.app import app
from minitouch_bench.episode import IN_MEMORY, Role
from minitouch_bench.errors import UsageError
from minitouch_bench.perturbation import Perturbation
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.protocol.limits import PolicyLimits
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL, TASK_NAMES
from minitouch_bench.runs.plan import PlannedObjects, make_plan
from minitouch_bench.runs.run import make_header
from minitouch_bench.shapegen.manifest import canonical_shape_set, load_shape_set
from tests.shapegen.conftest import subset


def test_the_official_suite():
    specs = make_plan("table4").specs()
    assert PROTOCOL.suite("table4").rankable
    assert len(specs) == len(set(specs)) == 400
    assert [spec.task for spec in specs[::100]] == list(TASK_NAMES)
    assert [spec.index for spec in specs[:100]] == list(range(100))
    assert not PROTOCOL.suite("smoke").rankable
    assert len(make_plan("smoke").specs()) == 20


def test_an_episode_does_not_depend_on_how_many_there_are_nor_on_the_tasks_beside_it():
    few = make_plan("table4", ("opening", "pick-up"), 3)
    assert set(few.specs(exploration=True)) < set(make_plan("table4").specs(exploration=True))


def test_exploration_faces_the_same_episodes_of_the_goals():
    specs = make_plan("table4").specs(exploration=True)
    exploration = [spec for spec in specs if spec.role is Role.EXPLORATION]
    assert {spec.task for spec in exploration} == set(GOAL_TASKS)
    assert [replace(spec, role=Role.FINAL) for spec in exploration] == [
        spec for spec in specs if spec.role is Role.FINAL and spec.task in GOAL_TASKS
    ]


def test_pick_up_draws_train_shapes_by_seed():
    specs = [spec for spec in make_plan("table4").specs() if spec.task == "pick-up"]
    train = {shape.name for shape in canonical_shape_set().split("train")}
    shapes = [spec.shape for spec in specs]
    assert len(set(shapes)) > 10
    assert set(shapes) <= train
    assert {spec.split for spec in specs} == {"train"}
    other = make_plan("table4", seed=5).specs()
    assert shapes != [spec.shape for spec in other if spec.task == "pick-up"]


def test_novel_shapes_faces_each_held_out_shape_once_and_as_many_others():
    whole, canonical = make_plan("novel-shapes").specs(), canonical_shape_set()
    held_out = sorted(shape.name for shape in canonical.split("held-out"))
    for task in ("playing", "pushing", "pick-up"):
        specs = [spec for spec in whole if spec.task == task]
        train = [spec.shape for spec in specs if spec.split == "train"]
        assert sorted(spec.shape for spec in specs if spec.split == "held-out") == held_out
        assert len(set(train)) == len(train) == len(held_out)
    assert set(make_plan("novel-shapes", episodes=4).specs()) < set(whole)


def test_what_makes_a_run_unofficial_is_said():
    plan = make_plan("table4")
    assert plan.why_unofficial() == ()
    changed = replace(plan, tasks=("pushing",), episodes=3, seed=7)
    reasons = ("tasks pushing only", "3 of 100 episodes per task", "seed 7")
    assert changed.why_unofficial() == reasons
    assert make_plan("smoke").why_unofficial() == ("suite smoke",)
    limits = PolicyLimits(1.0, 60.0, 600.0, 1)
    assert replace(plan, limits=limits).why_unofficial() == (
        "60 s per action",
        "600 s per episode",
        "1 s to load",
        "1 MiB of memory",
    )


def test_a_policy_and_its_isolation_can_make_a_run_unofficial():
    plan, zero = make_plan("table4"), parse_source("zero").identity()

    def why_unofficial(*policies_and_isolation):
        return make_header(plan, *policies_and_isolation).unofficial_because

    assert why_unofficial(zero, None, "sandbox") == ()
    in_memory = replace(zero, kind=IN_MEMORY)
    assert why_unofficial(zero, in_memory, "none") == ("policy in memory, beside the simulator",)
    for isolation, kind in (("process", "remote"), ("none", "scripted")):
        other = replace(zero, kind=kind)
        assert why_unofficial(other, None, isolation) == ()
        for policies in ((zero, None), (zero, other)):
            assert why_unofficial(*policies, isolation) == (f"isolation: {isolation}",)


@pytest.mark.parametrize(
    "plan",
    [
        make_plan("table4"),
        make_plan("smoke", ["opening", "pushing"], 3, 2**200),
        make_plan("novel-shapes", episodes_from=["pushing/3,17", "pick-up/0"], seed=1),
        make_plan(
            "table4",
            conditions=Perturbation(("vision",), force_noise=0.1, mass=(1 / 3, 2 / 3)),
            limits=PolicyLimits(act_timeout_s=2.0, episode_timeout_s=100.0),
        ),
        make_plan("smoke", ["pick-up"], objects="cube"),
        make_plan("table4", objects="held-out"),
        make_plan("table4", objects="shapes/minitouch-1000"),
    ],
    ids=lambda plan: " ".join(plan.as_options()),
)
def test_the_options_of_a_plan_make_it_again(plan, monkeypatch):
    made = []

    def take(_policy, plan, *_, **__):
        made.append(plan)
        raise UsageError("enough")

    monkeypatch.setattr("minitouch_bench.api.prepare_policies", take)
    command = typer.main.get_command(app)
    with pytest.raises(UsageError, match="enough"):
        command.main(["evaluate", "zero", *plan.as_options()], standalone_mode=False)
    assert made == [plan]


def test_own_objects_are_taken_in_turn_in_the_tasks_that_have_one(tmp_path):
    shapes = load_shape_set(subset(tmp_path / "set", 8))
    plan = make_plan("table4", episodes=10, objects=shapes)
    names = [shape.name for shape in shapes.shapes]
    assert plan == make_plan("table4", episodes=10, objects=str(tmp_path / "set"))
    assert plan.tasks == ("playing", "pushing", "pick-up")
    assert [spec.shape for spec in plan.specs()[:10]] == [*names, *names[:2]]
    assert {(spec.family, spec.split) for spec in plan.specs()} == {("", "")}  # new to any policy
    assert plan.why_unofficial()[-1] == f"objects set {shapes.digest[:12]}"
    assert plan.load_objects().digest == shapes.digest


def test_a_set_that_was_replaced_is_neither_played_nor_planned_with(tmp_path):
    shapes = load_shape_set(subset(tmp_path / "set", 8))
    plan = make_plan("table4", objects=shapes)
    shutil.rmtree(tmp_path / "set")
    subset(tmp_path / "set", 4)
    with pytest.raises(UsageError, match="not the set of the run"):
        plan.load_objects()
    with pytest.raises(UsageError, match="changed"):
        make_plan("table4", objects=shapes)


def test_shapes_of_this_package_keep_their_split():
    plan = make_plan("table4", ["pushing"], 3, objects=["shape-0003", "shape-0001"])
    assert [spec.shape for spec in plan.specs()] == ["shape-0003", "shape-0001", "shape-0003"]
    assert {spec.split for spec in plan.specs()} <= {"train", "held-out"}
    assert plan.load_objects() is None
    assert plan.changes_in_words() == ("objects shape-0003, shape-0001",)
    assert plan.objects.are_listed
    alone = PlannedObjects("mug", ("mug",), "sets/mug", "ab" * 32)
    assert not alone.are_listed  # the set is called as its only shape
    assert replace(plan, tasks=("opening",)).mistake() == "opening has no object to choose"
    with pytest.raises(UsageError, match="opening has no object"):
        make_plan("table4", ["opening"], objects="cube")


def test_tasks_are_chosen_in_the_suite_s_order():
    plan = make_plan("table4", ["pick-up", "playing", "playing"])
    assert plan.tasks == ("playing", "pick-up")


def test_chosen_episodes_are_those_of_the_whole_suite():
    chosen = make_plan("table4", episodes_from=["pushing/17, 3", "opening/0", "pushing/3"])
    keys = ("pushing/3", "pushing/17", "opening/0")
    assert chosen.chosen == keys
    specs = chosen.specs(exploration=True)
    assert [spec.key for spec in specs] == [*keys, *(f"exploration/{key}" for key in keys)]
    assert {*specs} < {*make_plan("table4").specs(exploration=True)}


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"suite": "table5"}, r"table4, .*smoke"),
        ({"tasks": ["pushing", "flying"]}, "no task 'flying'"),
        ({"tasks": []}, "no task ''"),
        ({"episodes_from": ["flying/0"]}, "no task 'flying'"),
        *(
            ({"episodes_from": [text]}, "no (task|episode) '")
            for text in ("pushing", "pushing/100", "pushing/1,,2", "")
        ),
    ],
)
def test_what_the_protocol_does_not_have_is_a_usage_error(asked, words):
    with pytest.raises(UsageError, match=words):
        make_plan(**{"suite": "table4", **asked})
