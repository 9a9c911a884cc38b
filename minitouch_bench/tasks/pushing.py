"""Pushing: push the cube to the target, a grey cube that is seen and not touched."""

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.records import Outcome
from minitouch_bench.sensing.camera import CameraPreset
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.simulation.panda_arm import POINTING_DOWN, PandaArm
from minitouch_bench.simulation.scene import TABLE_TOP_M, TARGET_COLOR, Workspace
from minitouch_bench.simulation.values import Part
from minitouch_bench.tasks.objects import ObjectModel, cube_model
from minitouch_bench.tasks.tabletop import TABLETOP_PORTRAIT, Placement, draw_yaw, position_of
from minitouch_bench.tasks.task import Task, TaskPreset

CUBE_SIDE_M = 0.05
CUBE_MASS_KG = 50.0
CUBE_FRICTION = 1.0
"""Sources: the released package."""
TARGET_MARGIN_M = 0.025
"""Least distance of the target from the workspace's sides: half the cube, so that all of it is
inside. Ours: the release's 20 cm leave a box of 5 x 5 cm, where nobody need look for it."""
NEAREST_M, FURTHEST_M = 0.10, 0.20
"""Range of the polar draws, cube around target and end effector around cube. Source: text."""
SUCCESS_DISTANCE_M = 0.07
"""Source: text (the release has 0.077)."""
BEHIND_M = 0.07
"""The place this far behind the cube, seen from the target, must be in the workspace, else
nobody could push it there. Ours."""
START_HEIGHT_M = 0.02
"""Height of the end effector at the start. Ours."""
WORKSPACE = Workspace((0.25, -0.20, 0.0), (0.70, 0.25, 0.035))
"""Source: text ("positions that can be reached"); the release's x from 0.10 cannot be."""

Place = tuple[float, float]


class Pushing(Task):
    """A heavy cube near its target."""

    preset: ClassVar[TaskPreset] = TaskPreset(
        name="pushing",
        goal="object nearer than 7 cm to the target",
        workspace=WORKSPACE,
        camera=CameraPreset((0.475, 0.025, -0.2), yaw=90.0, pitch=-60.0, near=0.26),
        portrait=TABLETOP_PORTRAIT,
        arm=POINTING_DOWN,
    )

    @staticmethod
    def own_object() -> ObjectModel:
        """Return the task's cube."""
        return cube_model(CUBE_SIDE_M, CUBE_MASS_KG, CUBE_FRICTION)

    @property
    def model(self) -> ObjectModel:
        """The object of this episode."""
        return self._object.model

    @property
    def target(self) -> Place:
        """Where the object is to go: x, y (m)."""
        return self._target

    def draw(self, rng: np.random.Generator, model: ObjectModel | None) -> None:
        """Draw the target, the object around it, and the end effector around the object."""
        model = model or self.own_object()
        self._target = WORKSPACE.draw_place(rng, TARGET_MARGIN_M)
        place = _draw_around(rng, self._target)
        while not WORKSPACE.holds(*_behind(place, self._target)):
            place = _draw_around(rng, self._target)
        self._start = _draw_around(rng, place)
        while not WORKSPACE.holds(*self._start):
            self._start = _draw_around(rng, place)
        self._object = Placement(model, *place, draw_yaw(rng, model))

    def add_scenery(self, client: PhysicsClient) -> tuple[Part, ...]:
        """Add the target."""
        half = CUBE_SIDE_M / 2
        self._marker = client.add_ghost_box(
            (half,) * 3, (*self._target, TABLE_TOP_M + half), TARGET_COLOR
        )
        return ((self._marker, -1),)

    @property
    def landmarks(self) -> tuple[int, ...]:
        """The object and the target."""
        return self.target_body, self._marker

    def add_object(self, client: PhysicsClient) -> None:
        """Add the object."""
        self.target_body = self._object.load(client)

    def place_arm(self, arm: PandaArm) -> None:
        """Move the end effector to its start."""
        arm.place((*self._start, START_HEIGHT_M))

    def object_state(self, client: PhysicsClient) -> NDArray[np.float64]:
        """Return the object's position, float64 (3,) in m."""
        return position_of(client, self.target_body)

    def outcome(self, client: PhysicsClient) -> Outcome | None:
        """Return success near the target, a failure outside the workspace."""
        x, y, _ = client.pose(self.target_body).position
        if math.dist((x, y), self._target) < SUCCESS_DISTANCE_M:
            return Outcome.SUCCESS
        return None if WORKSPACE.holds(x, y) else Outcome.LEFT_WORKSPACE


def _draw_around(rng: np.random.Generator, center: Place) -> Place:
    """Draw a place around another, uniform in angle and distance."""
    angle = rng.uniform(0.0, 2.0 * math.pi)
    distance = rng.uniform(NEAREST_M, FURTHEST_M)
    return center[0] + distance * math.cos(angle), center[1] + distance * math.sin(angle)


def _behind(place: Place, target: Place) -> Place:
    """Return the place behind an object from which it is pushed to the target."""
    scale = BEHIND_M / math.dist(place, target)
    return (
        place[0] + scale * (place[0] - target[0]),
        place[1] + scale * (place[1] - target[1]),
    )
