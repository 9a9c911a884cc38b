import numpy as np
import pytest

from minitouch_bench.policies.scripted import make_controller
from minitouch_bench.simulation.client import pybullet
from minitouch_bench.simulation.observation import (
    FORCES,
    OPENINGS,
    POSITION,
    ContactWatch,
    read_touch,
)
from minitouch_bench.tasks.environment import MiniTouchEnv


@pytest.fixture(scope="module")
def environment():
    return MiniTouchEnv("playing")


def test_what_is_read_is_the_arm_s_state(environment):
    environment.reset(seed=1)
    touch = read_touch(environment.arm, 50.0)
    assert touch.dtype == np.float32
    assert touch[POSITION] == pytest.approx(environment.arm.position)
    assert touch[OPENINGS].tolist() == [0.0, 0.0]
    environment.arm._place_joints([0.0, 0.5, 0.0, -1.5, 0.0, 2.0, 0.8])
    environment.client.set_joint(environment.arm.body, 9, 0.03)
    environment.client.set_joint(environment.arm.body, 10, 0.01)
    assert read_touch(environment.arm, 50.0)[OPENINGS] == pytest.approx([0.75, 0.25])


def test_a_press_is_felt_and_clipped(environment):
    environment.reset(seed=1)
    controller = make_controller(environment)
    forces = []
    for _ in range(15):
        environment.step(controller.act())
        forces.append(read_touch(environment.arm, 3.0)[FORCES])
    assert np.abs(forces).max() == 3.0
    environment.reset(seed=1)
    assert np.abs(read_touch(environment.arm, 50.0)[FORCES]).max() == 0.0


@pytest.mark.parametrize("task", ["playing", "opening", "pick-up"])
def test_contacts_are_what_the_simulator_says_tick_by_tick(task):
    environment = MiniTouchEnv(task)
    environment.reset(seed=1)
    client, arm, scene = environment.client, environment.arm, environment.task
    watch = ContactWatch(client, arm.body, scene.target_body, scene.target_links)
    ticks = []

    def after_tick():
        points = pybullet.getContactPoints(
            arm.body, scene.target_body, physicsClientId=client._bullet.id
        )
        ticks.append({p[3] for p in points if p[9] > 0 and p[3] in (9, 10)})
        watch.after_tick()

    controller = make_controller(environment)
    space = scene.spec.workspace
    for _ in range(25):
        arm.move(controller.act(), space.low, space.high, after_tick)
    begun = [now - before for before, now in zip([set(), *ticks], ticks, strict=False)]
    assert watch.contact_ticks == sum(bool(fingers) for fingers in ticks) > 0
    assert watch.onsets == sum(len(fingers) for fingers in begun)
    assert watch.first_tick == next(tick for tick, fingers in enumerate(ticks) if fingers)


def test_the_contacts_of_steps_add_up(environment):
    environment.reset(seed=2)
    *_, info = environment.step(np.array((0, 0, 1, 0), np.float32))  # in the air
    assert (info["contact_ticks"], info["onsets"], info["first_touch_tick"]) == (0, 0, -1)
    environment.reset(seed=2)
    controller = make_controller(environment)
    contact = ticks = onsets = 0
    first = -1
    for _ in range(15):
        *_, info = environment.step(controller.act())
        if first < 0 < info["contact_ticks"]:
            first = info["first_touch_tick"]
            assert ticks <= first < ticks + info["ticks"]
        contact, ticks = contact + info["contact_ticks"], ticks + info["ticks"]
        onsets += info["onsets"]
    assert contact > onsets > 0
    assert info["first_touch_tick"] == first
