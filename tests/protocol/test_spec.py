import hashlib
from dataclasses import replace

import pytest

from minitouch_bench.protocol.minitouch import MAIN_SUITE, NOVEL_SHAPES, PROTOCOL, TASK_NAMES
from minitouch_bench.shapegen.manifest import canonical_shape_set
from minitouch_bench.simulation.bodies import PANDA


def digests(protocol):
    return {task: protocol.task_digest(task, MAIN_SUITE) for task in TASK_NAMES}


def with_task(name, **changes):
    tasks = tuple(replace(t, **changes) if t.name == name else t for t in PROTOCOL.tasks)
    return replace(PROTOCOL, tasks=tasks)


def changed(protocol):
    """Return the tasks whose digest differs from the protocol's."""
    return {task for task in TASK_NAMES if digests(protocol)[task] != digests(PROTOCOL)[task]}


@pytest.mark.parametrize(
    "change",
    [
        {"physics": replace(PROTOCOL.physics, simulator="pybullet 3.2.8")},
        {"observation": replace(PROTOCOL.observation, object_color=(0.0, 0.0, 0.0, 1.0))},
        {"seeds": PROTOCOL.seeds + 1},
    ],
)
def test_what_all_tasks_share_changes_every_digest(change):
    assert changed(replace(PROTOCOL, **change)) == set(TASK_NAMES)


@pytest.mark.parametrize(
    ("task", "changes"),
    [
        ("pushing", {"success_distance": 0.077}),
        ("opening", {"cabinet": replace(PROTOCOL.task("opening").cabinet, hinge_friction=0.4)}),
        ("playing", {"max_steps": 100}),
        ("pick-up", {"revision": 99}),
    ],
)
def test_a_task_s_own_value_changes_its_digest_alone(task, changes):
    other = with_task(task, **changes)
    assert changed(other) == {task}
    assert other.digest() != PROTOCOL.digest()


def test_neither_what_people_see_nor_a_fifth_task_changes_a_digest():
    portrait = replace(PROTOCOL.task("pushing").portrait, yaw=1.0)
    shown = with_task("pushing", portrait=portrait, goal="win", title="Shove")
    fifth = replace(PROTOCOL.task("pushing"), name="pegging")
    for other in (shown, replace(PROTOCOL, tasks=(*PROTOCOL.tasks, fifth))):
        assert changed(other) == set()
        assert other.digest() == PROTOCOL.digest()


def test_another_shape_set_changes_the_tasks_that_take_objects_from_it():
    other = replace(PROTOCOL, shapes="other")
    assert changed(other) == {"pick-up"}
    for task in PROTOCOL.suite(NOVEL_SHAPES).tasks:
        assert other.task_digest(task, NOVEL_SHAPES) != PROTOCOL.task_digest(task, NOVEL_SHAPES)
    assert other.digest() != PROTOCOL.digest()


def test_the_meshes_and_shapes_are_those_of_the_protocol():
    sha = hashlib.sha256()
    for path in sorted(PANDA.parent.glob("*.obj")):
        sha.update(hashlib.sha256(path.read_bytes()).digest())
    assert sha.hexdigest()[:16] == PROTOCOL.physics.arm_meshes
    assert canonical_shape_set().digest == PROTOCOL.shapes
