# ruff: noqa: F821  these lines go into policies/scripted.py, before its table
from minitouch_bench.tasks.peg import Peg


class PegController(PickUpController):
    """Grasp the peg as in Pick-up, carry it over the plate, and set it down."""

    CARRIED_M = 0.07
    """Height of the end effector on the way to the plate."""
    OVER_M = 0.025
    GENTLE = np.float32(0.3)

    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 (4,)."""
        action = super().act()
        is_lifting = action[2] == np.float32(self.LIFT) and action[3] == CLOSE
        if not is_lifting:
            return action
        x, y, _ = self.object_state
        plate = cast(Peg, self.environment.task).plate
        offset = np.subtract(plate, (x, y))
        if np.abs(offset).max() < self.OVER_M:
            goal = self.hand - (0.0, 0.0, 0.01)
        elif self.hand[2] < self.CARRIED_M - 0.01:
            goal = np.array((*self.hand[:2], self.CARRIED_M))
        else:
            goal = self.hand
            goal[:2] += offset
        action = self.toward(goal, finger=CLOSE)
        action[:3] *= self.GENTLE
        return action
