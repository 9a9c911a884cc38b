"""Playing by script: press the closed fingers against the cube, and keep pressing."""

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.policies.scripted.controller import Controller

PRESS_HEIGHT_M = 0.0


class PlayingController(Controller):
    """Drive at the middle of the object, low enough to meet its side."""

    def act(self) -> NDArray[np.float32]:
        """Return the next action, float32 (4,)."""
        x, y, _ = self.object_state
        return self.toward((x, y, PRESS_HEIGHT_M))
