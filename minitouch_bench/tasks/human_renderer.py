"""Pictures for people: the scene with the full Panda and shadows, at any size."""

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.simulation.client import PhysicsClient, View
from minitouch_bench.simulation.panda_model import stock_panda
from minitouch_bench.simulation.scene import add_table
from minitouch_bench.tasks.task import Task


class HumanRenderer:
    """A second world, only ever drawn, that mirrors the poses of the simulated one.

    It is built in the same order, so that bodies have the same ids in both.
    """

    def __init__(self, width: int, height: int) -> None:
        self._client = PhysicsClient()
        self._size = (width, height)
        self._built_for: Task | None = None

    def close(self) -> None:
        """Free its world."""
        self._client.close()

    def forget(self) -> None:
        """Build the scene again at the next picture, because it has changed."""
        self._built_for = None

    def picture(self, task: Task, simulated: PhysicsClient) -> NDArray[np.uint8]:
        """Return a picture of the simulated world as it is, uint8 (height, width, 3)."""
        if self._built_for is not task:
            self._build(task)
        self._client.mirror(simulated)
        width, height = self._size
        view = View.of(task.spec.portrait, aspect=width / height)
        return self._client.render(view, width, height, shadow=True).rgb.copy()

    def _build(self, task: Task) -> None:
        self._client.reset_world()
        add_table(self._client)
        task.add_scenery(self._client)
        task.add_object(self._client)
        self._client.load_urdf(stock_panda(), fixed=True)
        self._built_for = task
