"""What the controllers share: how to move towards a position; and Playing, which needs no more."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.tasks.environment import MiniTouchEnv


class Controller(ABC):
    """A controller of one episode, which may look at the whole simulator."""

    def __init__(self, environment: MiniTouchEnv) -> None:
        self.environment = environment
        self.client = environment.client

    @abstractmethod
    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 of the task's size, in [-1, 1]."""

    @property
    def hand(self) -> NDArray[np.float64]:
        """End-effector position, float64 (3,) in m."""
        return np.array(self.environment.arm.position)

    @property
    def object_state(self) -> NDArray[np.float64]:
        """The object's position, float64 (3,) in m, or the door's angle, (1,) in rad."""
        return self.environment.task.object_state(self.client)

    def toward(
        self,
        goal: Sequence[float] | NDArray[np.float64],
        *,
        finger: float = 0.0,
        yaw: float = 0.0,
    ) -> NDArray[np.float32]:
        """Return the action towards ``goal`` (m), the ``finger`` number and a ``yaw`` (rad)."""
        offset = (np.asarray(goal) - self.hand) / PROTOCOL.control.reach
        offset /= max(1.0, float(np.abs(offset).max()))
        action = [*offset, finger]
        if self.environment.task.spec.arm.faces_door:
            turn = (yaw - self.environment.arm.yaw) / PROTOCOL.control.yaw_reach
            action.append(float(np.clip(turn, -1.0, 1.0)))
        return np.array(action, np.float32)


class PlayingController(Controller):
    """Press the closed fingers against the object: drive at its middle, low."""

    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 (4,)."""
        x, y, _ = self.object_state
        return self.toward((x, y, 0.0))
