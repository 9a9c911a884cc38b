import numpy as np
import pytest
from pybullet import getContactPoints

from minitouch_bench.policies.scripted import make_controller
from minitouch_bench.simulation.observation import ContactWatch


@pytest.mark.parametrize("task", ["playing", "opening", "pick-up"])
def test_it_counts_what_the_simulator_says_tick_by_tick(environments, task):
    environment = environments[task]
    environment.reset(seed=1)
    client, arm, scene = environment.client, environment.arm, environment.task
    watch = ContactWatch(client, arm.body, scene.target_body, scene.target_links)
    ticks = []

    def after_tick():
        points = getContactPoints(arm.body, scene.target_body, physicsClientId=client._bullet.id)
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


def test_the_episode_counts_add_up(environments):
    environment = environments["playing"]
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
