"""The scripted policy: it reads the simulator's state, and every table says so.

It acts through the same actions as any policy, with no force and no teleport of its own, and
so proves that each task can be solved.
"""

from minitouch_bench.policies.scripted.controller import Controller, PlayingController
from minitouch_bench.policies.scripted.opening import OpeningController
from minitouch_bench.policies.scripted.pick_up import PickUpController
from minitouch_bench.policies.scripted.pushing import PushingController
from minitouch_bench.tasks.environment import MiniTouchEnv

CONTROLLERS: dict[str, type[Controller]] = {
    "playing": PlayingController,
    "pushing": PushingController,
    "opening": OpeningController,
    "pick-up": PickUpController,
}


def make_controller(environment: MiniTouchEnv) -> Controller:
    """Return the controller of one episode of the environment's task."""
    return CONTROLLERS[environment.task.spec.name](environment)


__all__ = ["CONTROLLERS", "Controller", "make_controller"]
