"""What a task is: its facts, its scene, its objects; the four tasks, and the table of them."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Outcome, Start
from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import (
    OPENING,
    PICK_UP,
    PLAYING,
    PROTOCOL,
    PUSHING,
    CubeSpec,
    OpeningSpec,
    PickUpSpec,
    PushingSpec,
    TabletopSpec,
)
from minitouch_bench.protocol.spec import CUBE, TaskSpec, Workspace
from minitouch_bench.shapegen.geometry import Mesh, Quaternion, product, rotation_matrix
from minitouch_bench.shapegen.manifest import Objects, Shape, canonical_shape_set, choose_shapes
from minitouch_bench.simulation import bodies
from minitouch_bench.simulation.client import Part, PhysicsClient
from minitouch_bench.simulation.panda_arm import PandaArm

_CUBE_FACES = (
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
    (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
)  # fmt: skip


@dataclass(frozen=True)
class ObjectModel:
    """An object that can be loaded.

    ``rest``: a stable orientation (quaternion x, y, z, w), and ``rest_height`` the height
    of its center of mass (m) when it lies so. ``surface`` is its closed surface, and
    ``corners`` float64 (N, 3) those of its convex parts, about the center of mass (m).
    ``is_task_cube``: the task's own cube, which lies square and at rest. The name does not say so:
    a shape of a user's set can have any.
    """

    name: str
    urdf: Path
    rest: Quaternion
    rest_height: float
    surface: Mesh
    corners: NDArray[np.float64]
    is_task_cube: bool = False

    def load(self, client: PhysicsClient, x: float, y: float, yaw: float) -> int:
        """Add the object at a place on the table (m), turned by ``yaw`` (rad)."""
        return client.load_urdf(
            self.urdf,
            (x, y, PROTOCOL.physics.table_top + self.rest_height),
            product((0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)), self.rest),
            inertia_from_file=True,
        )

    def heights(self, client: PhysicsClient, body: int) -> tuple[float, float]:
        """Return the heights of the lowest and highest corner (m), without the collision margin."""
        position, orientation = client.pose(body)
        corners = position[2] + (self.corners * rotation_matrix(orientation)[2]).sum(axis=1)
        return float(corners.min()), float(corners.max())


def cube_model(cube: CubeSpec) -> ObjectModel:
    """Return a task's own cube."""
    half = cube.side / 2
    signs = [(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
    corners = np.array(signs) * half
    surface = Mesh(corners, np.array(_CUBE_FACES, np.int32))
    lying = (0.0, 0.0, 0.0, 1.0)
    return ObjectModel(
        CUBE, bodies.cube_urdf(cube), lying, half, surface, corners, is_task_cube=True
    )


class ObjectPool:
    """The objects an environment draws from, loaded when first used.

    A name means the object of this name that can be drawn. Where all of them come with this
    package, it can also mean any other shape of the canonical set, or the task's cube.
    """

    def __init__(self, cube: ObjectModel, chosen: Objects) -> None:
        self._cube = cube
        shapes = () if chosen == CUBE else choose_shapes(chosen)
        self._shapes = {shape.name: shape for shape in shapes}
        for shape in shapes:
            if self._shapes[shape.name] != shape:
                raise UsageError(f"two of the objects are called '{shape.name}': leave out one")
        self._are_canonical = all(
            shape.pack.parent == canonical_shape_set().path for shape in shapes
        )
        self.names = tuple(self._shapes) or (CUBE,)
        self.model = cache(self._load)
        """Returns the object of a name, or raises a UsageError."""

    def _load(self, name: str) -> ObjectModel:
        if shape := self._shapes.get(name):
            return shape_model(shape)
        if not self._are_canonical:
            raise UsageError(
                f"no object '{name}' is among the {len(self.names)} of the environment"
            )
        return self._cube if name == CUBE else shape_model(canonical_shape_set().by_name(name))

    def draw(self, rng: np.random.Generator) -> ObjectModel:
        """Return one object, all equally likely."""
        return self.model(self.names[int(rng.integers(len(self.names)))])


def shape_model(shape: Shape) -> ObjectModel:
    """Return a shape as an object, lying as the first of its poses says."""
    body, pose = shape.body(), shape.poses[0]
    corners = np.concatenate([hull.vertices for hull in body.hulls])
    return ObjectModel(shape.name, shape.urdf, pose.quaternion, pose.height, body.visual, corners)


Position = tuple[float, float]
"""x, y (m) on the table."""

START_XY = (0.700, -0.029)
"""Where the end effector of ``POINTING_DOWN`` starts (m), at a height of 0.039 m."""


class Task(ABC):
    """The scene, the object and the goal of one task.

    A reset calls ``draw``, ``add_scenery``, ``add_object`` and ``place_arm`` in this order; the
    same draws in the same order build the same world, bit for bit.
    """

    spec: ClassVar[TaskSpec]
    target_body: int
    """The body whose contact with the fingers counts as touch."""
    target_links: tuple[int, ...] = (-1,)
    """Its links that count (-1 is the base)."""

    @property
    def visible_bodies(self) -> tuple[int, ...]:
        """The bodies that the camera must see when an episode begins."""
        return (self.target_body,)

    @classmethod
    def own_object(cls) -> ObjectModel | None:
        """Return the task's own object, None where it has none to choose."""
        return None

    @abstractmethod
    def draw(self, rng: np.random.Generator, model: ObjectModel | None) -> None:
        """Draw where everything stands, with ``model`` in place of the task's own object."""

    def add_scenery(self, client: PhysicsClient) -> tuple[Part, ...]:
        """Add what stands beside the table, and return those of its parts that never move."""
        return ()

    def add_object(self, client: PhysicsClient) -> None:  # noqa: B027  Opening has none
        """Add the object, at rest."""

    def place_arm(self, arm: PandaArm) -> None:  # noqa: B027
        """Move the arm away from its start joints, where the task asks for it."""

    @abstractmethod
    def start(self, client: PhysicsClient, end_effector: tuple[float, float, float]) -> Start:
        """Return where the episode begins; ``end_effector`` is there (m)."""

    @abstractmethod
    def object_state(self, client: PhysicsClient) -> NDArray[np.float64]:
        """Return the object's position, float64 (3,) in m, or the door's angle, (1,) in rad."""

    @abstractmethod
    def outcome(self, client: PhysicsClient) -> Outcome | None:
        """Return how the episode has just ended, None if it goes on."""

    def reward(self, client: PhysicsClient, outcome: Outcome | None) -> float:
        """Return the reward of the step that has just been done: sparse, if not overridden."""
        return self.spec.success_reward if outcome is Outcome.SUCCESS else 0.0


class TabletopTask(Task):
    """A task with one object, at a random position on the table."""

    spec: ClassVar[TabletopSpec]
    model: ObjectModel
    """The object of this episode."""
    position: Position
    """Where it is put."""
    yaw: float
    """How it is turned (rad)."""
    target: Position | None = None
    """Where the object is to go."""

    @classmethod
    def own_object(cls) -> ObjectModel:
        """Return the task's cube."""
        return cube_model(cls.spec.cube)

    def draw(self, rng: np.random.Generator, model: ObjectModel | None) -> None:
        """Draw a uniform position in the workspace less a margin that the hand does not cover."""
        self.model = model or self.own_object()
        self.position = draw_position(self.spec.workspace, rng, self.spec.margin)
        while math.dist(self.position, START_XY) < self.spec.clearance:
            self.position = draw_position(self.spec.workspace, rng, self.spec.margin)
        self.yaw = draw_yaw(rng, self.model)

    def add_object(self, client: PhysicsClient) -> None:
        """Add the object and let it come to rest."""
        self.target_body = self.model.load(client, *self.position, self.yaw)
        client.paint({(self.target_body, -1): PROTOCOL.observation.object_color})
        if not self.model.is_task_cube:
            for _ in range(self.spec.settle_ticks):
                client.step()

    def start(self, client: PhysicsClient, end_effector: tuple[float, float, float]) -> Start:
        """Return where the object lies."""
        place = client.pose(self.target_body).position
        return Start(place, self.yaw, self.target, end_effector)

    def object_state(self, client: PhysicsClient) -> NDArray[np.float64]:
        """Return the object's center of mass, float64 (3,) in m."""
        return np.array(client.pose(self.target_body).position)

    def outcome(self, client: PhysicsClient) -> Outcome | None:
        """Return success, or a failure if the object has left a workspace that it can leave."""
        x, y, _ = client.pose(self.target_body).position
        if self.succeeds(client, (x, y)):
            return Outcome.SUCCESS
        is_left = self.spec.object_can_leave and not self.spec.workspace.holds(x, y)
        return Outcome.LEFT_WORKSPACE if is_left else None

    def succeeds(self, client: PhysicsClient, position: Position) -> bool:
        """Tell whether the task is done with the object there; without a goal it never is."""
        return False


def draw_position(workspace: Workspace, rng: np.random.Generator, margin: float) -> Position:
    """Return a uniform position (m) at least ``margin`` from the four sides."""
    x = rng.uniform(workspace.low[0] + margin, workspace.high[0] - margin)
    y = rng.uniform(workspace.low[1] + margin, workspace.high[1] - margin)
    return float(x), float(y)


def draw_yaw(rng: np.random.Generator, model: ObjectModel) -> float:
    """Return a random yaw (rad) for a shape; the tasks' own cubes lie square."""
    return 0.0 if model.is_task_cube else float(rng.uniform(0.0, 2.0 * math.pi))


class Playing(TabletopTask):
    """A heavy cube at a random position."""

    spec: ClassVar[TabletopSpec] = PLAYING


class Pushing(TabletopTask):
    """A heavy cube near its target."""

    spec: ClassVar[PushingSpec] = PUSHING

    target: Position

    @property
    def visible_bodies(self) -> tuple[int, ...]:
        """The object and the target."""
        return self.target_body, self._marker

    def draw(self, rng: np.random.Generator, model: ObjectModel | None) -> None:
        """Draw the target, the object around it, and the end effector around the object."""
        workspace = self.spec.workspace
        self.model = model or self.own_object()
        self.target = draw_position(workspace, rng, self.spec.target_margin)
        self.position = _draw_around(rng, self.target, self.spec.cube_distance)
        while not workspace.holds(*self._behind()):
            self.position = _draw_around(rng, self.target, self.spec.cube_distance)
        self._start = _draw_around(rng, self.position, self.spec.hand_distance)
        while not workspace.holds(*self._start):
            self._start = _draw_around(rng, self.position, self.spec.hand_distance)
        self.yaw = draw_yaw(rng, self.model)

    def add_scenery(self, client: PhysicsClient) -> tuple[Part, ...]:
        """Add the target."""
        half = self.spec.cube.side / 2
        height = PROTOCOL.physics.table_top + half
        color = PROTOCOL.observation.target_color
        self._marker = client.add_box((half,) * 3, (*self.target, height), color)
        return ((self._marker, -1),)

    def place_arm(self, arm: PandaArm) -> None:
        """Move the end effector to its start."""
        arm.place((*self._start, self.spec.start_height))

    def succeeds(self, client: PhysicsClient, position: Position) -> bool:
        """Tell whether the object is near its target."""
        return math.dist(position, self.target) < self.spec.success_distance

    def _behind(self) -> Position:
        """Return the position behind the object from which it is pushed to the target."""
        x, y = self.position
        scale = self.spec.push_clearance / math.dist(self.position, self.target)
        return x + scale * (x - self.target[0]), y + scale * (y - self.target[1])


def _draw_around(
    rng: np.random.Generator, center: Position, distances: tuple[float, float]
) -> Position:
    """Draw a position around another, uniform in angle and distance."""
    angle = rng.uniform(0.0, 2.0 * math.pi)
    distance = rng.uniform(*distances)
    return center[0] + distance * math.cos(angle), center[1] + distance * math.sin(angle)


class Opening(Task):
    """A cabinet with one hinged door at a random position in reach."""

    spec: ClassVar[OpeningSpec] = OPENING
    target_links = (bodies.DOOR_LINK, bodies.HANDLE_LINK)

    position: tuple[float, float]
    """Where the cabinet stands: x of its front and y of its middle (m)."""

    def draw(self, rng: np.random.Generator, model: ObjectModel | None) -> None:
        """Draw the position of the cabinet."""
        self.position = rng.uniform(*self.spec.front), rng.uniform(*self.spec.middle)

    def add_scenery(self, client: PhysicsClient) -> tuple[Part, ...]:
        """Add the cabinet; its body never moves."""
        cabinet = self.spec.cabinet
        floor = (*self.position, PROTOCOL.physics.table_top)
        self.target_body = client.load_urdf(bodies.cabinet_urdf(cabinet), floor, fixed=True)
        client.set_joint_friction(self.target_body, bodies.DOOR_JOINT, cabinet.hinge_friction)
        return ((self.target_body, -1),)

    def start(self, client: PhysicsClient, end_effector: tuple[float, float, float]) -> Start:
        """Return where the cabinet stands."""
        floor = (*self.position, PROTOCOL.physics.table_top)
        return Start(floor, 0.0, None, end_effector)

    def object_state(self, client: PhysicsClient) -> NDArray[np.float64]:
        """Return the door's angle, float64 (1,) in rad."""
        return np.array(client.joint_positions(self.target_body, [bodies.DOOR_JOINT]))

    def outcome(self, client: PhysicsClient) -> Outcome | None:
        """Return success at 30 degrees."""
        opened = self.object_state(client)[0] >= self.spec.success_angle
        return Outcome.SUCCESS if opened else None


class PickUp(TabletopTask):
    """An object of a shape set, lying still."""

    spec: ClassVar[PickUpSpec] = PICK_UP

    def succeeds(self, client: PhysicsClient, position: Position) -> bool:
        """Tell whether the whole object is 5 cm above the table."""
        lowest, _ = self.model.heights(client, self.target_body)
        return lowest - PROTOCOL.physics.table_top >= self.spec.lift


TASK_CLASSES: dict[str, type[Task]] = {
    task.spec.name: task for task in (Playing, Pushing, Opening, PickUp)
}
"""Every task by its name on the command line."""
