"""The one place that calls PyBullet, which is imported without its line on stderr."""

import math
import os
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import CameraSpec, Rgba
from minitouch_bench.simulation.builds import check_version


def _import_pybullet() -> Any:
    saved, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        import pybullet  # noqa: PLC0415  only here can the line be caught

        return pybullet
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nowhere)


pybullet: Any = _import_pybullet()

check_version()

Vector = Sequence[float]
Part = tuple[int, int]
"""A body and one of its links (-1 is the base)."""

INVISIBLE: Rgba = (1.0, 1.0, 1.0, 0.0)


class Pose(NamedTuple):
    """Position (m) and orientation (quaternion x, y, z, w) in the world."""

    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float]


class Contact(NamedTuple):
    """A contact point seen from the first body: the two links and the normal force (N)."""

    link_a: int
    link_b: int
    normal_force: float


class Image(NamedTuple):
    """A rendered picture: ``rgb`` uint8 (H, W, 3) and ``depth`` float32 (H, W), 1 = nothing.

    ``bodies`` int32 (H, W): the body seen at each pixel, -1 where there is none; empty unless
    asked for.
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    bodies: NDArray[np.int32]


def _matrices(camera: CameraSpec, aspect: float) -> tuple[Vector, Vector]:
    """Return a camera's view and projection as PyBullet's matrices (16 numbers each); z is up."""
    return (
        pybullet.computeViewMatrixFromYawPitchRoll(
            camera.target, camera.distance, camera.yaw, camera.pitch, 0.0, 2
        ),
        pybullet.computeProjectionMatrixFOV(camera.field_of_view, aspect, camera.near, camera.far),
    )


def pixels_of(
    camera: CameraSpec,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: float,
    size: tuple[int, int],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the row and column of points (m) in a camera's image, ``size`` wide and high."""
    view, projection = _matrices(camera, size[0] / size[1])
    points = np.stack(np.broadcast_arrays(x, y, z, 1.0), axis=-1)
    seen = points @ np.reshape(view, (4, 4)) @ np.reshape(projection, (4, 4))
    across, up = seen[..., 0] / seen[..., 3], seen[..., 1] / seen[..., 3]
    row, column = size[1] * (1 - up) / 2, size[0] * (1 + across) / 2
    return row.clip(0, size[1] - 1).astype(int), column.clip(0, size[0] - 1).astype(int)


def quaternion_from_euler(angles: Vector) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of fixed-axis roll, pitch, yaw (rad)."""
    return pybullet.getQuaternionFromEuler(angles)


ANY_LINK = -2
"""PyBullet's wildcard for a link."""


class _OneWorld:
    """PyBullet's functions for one world; ``bullet_client`` has PyBullet print a line to stdout.

    The world is freed when it is closed or no longer used.
    """

    def __init__(self) -> None:
        self._id: int = pybullet.connect(pybullet.DIRECT)
        self._free = weakref.finalize(self, pybullet.disconnect, self._id)
        self._free.atexit = False  # the process takes its memory with it

    @property
    def id(self) -> int:
        """PyBullet's number of the world.

        Raises:
            UsageError: the world is closed; PyBullet then gives its number to another one.
        """
        if self._id < 0:
            raise UsageError("the environment is closed: make another one")
        return self._id

    def close(self) -> None:
        """Free the world."""
        self._id = -1
        self._free()

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return partial(getattr(pybullet, name), physicsClientId=self.id)


class PhysicsClient:
    """A private PyBullet world without a window; several can live in one process."""

    def __init__(self) -> None:
        self._bullet = _OneWorld()
        self.reset_world()

    def close(self) -> None:
        """Free the world; a closed client cannot be used again."""
        self._bullet.close()

    def reset_world(self) -> None:
        """Empty the world. Loading the same bodies in the same order after it is bit-identical.

        Resetting poses in place, or ``restoreState``, is not: contact caches and the order
        of overlapping pairs survive both.
        """
        self._bullet.resetSimulation()
        tick = 1.0 / PROTOCOL.physics.tick_rate
        self._bullet.setPhysicsEngineParameter(deterministicOverlappingPairs=1, fixedTimeStep=tick)
        self._bullet.setGravity(0.0, 0.0, PROTOCOL.physics.gravity)

    def step(self) -> None:
        """Advance one tick of 1/240 s."""
        pybullet.stepSimulation(self._bullet.id)

    # Bodies

    def load_urdf(
        self,
        path: Path,
        position: Vector = (0.0, 0.0, 0.0),
        orientation: Vector = (0.0, 0.0, 0.0, 1.0),
        *,
        fixed: bool = False,
        inertia_from_file: bool = False,
    ) -> int:
        """Load a URDF and return its id; PyBullet derives inertia without ``inertia_from_file``."""
        flags = pybullet.URDF_ENABLE_CACHED_GRAPHICS_SHAPES
        if inertia_from_file:
            flags |= pybullet.URDF_USE_INERTIA_FROM_FILE
        load = self._bullet.loadURDF
        return int(load(str(path), position, orientation, useFixedBase=fixed, flags=flags))

    def add_box(
        self, half_extents: Vector, position: Vector, color: Rgba, *, friction: float | None = None
    ) -> int:
        """Add a box (m) that never moves and return its id; without friction, one never touched."""
        collision = -1
        if friction is not None:
            collision = self._bullet.createCollisionShape(
                pybullet.GEOM_BOX, halfExtents=half_extents
            )
        visual = self._bullet.createVisualShape(
            pybullet.GEOM_BOX,
            halfExtents=half_extents,
            rgbaColor=color,
            specularColor=(0.0, 0.0, 0.0),
        )
        body = int(self._bullet.createMultiBody(0.0, collision, visual, position))
        if friction is not None:
            self._bullet.changeDynamics(body, -1, lateralFriction=friction)
        return body

    def colors(self) -> dict[Part, Rgba]:
        """Return the color of every link that has a picture."""
        return {
            (shape[0], shape[1]): shape[7]
            for body in range(self._bullet.getNumBodies())
            for shape in self._bullet.getVisualShapeData(body)
        }

    def paint(self, colors: Mapping[Part, Rgba]) -> None:
        """Change the color of links; alpha 0 keeps the renderer from drawing one."""
        for (body, link), color in colors.items():
            self._bullet.changeVisualShape(body, link, rgbaColor=color)

    def mirror(self, other: "PhysicsClient") -> None:
        """Take over the pose of every body and joint of a world built in the same order."""
        for body in range(other._bullet.getNumBodies()):
            self.set_pose(body, *other.pose(body))
            for joint in range(other._bullet.getNumJoints(body)):
                self.set_joint(body, joint, other.joint_positions(body, [joint])[0])

    def pose(self, body: int) -> Pose:
        """Return the pose of a body's center of mass."""
        return Pose(*self._bullet.getBasePositionAndOrientation(body))

    def set_pose(self, body: int, position: Vector, orientation: Vector) -> None:
        """Place a body's center of mass, at rest."""
        self._bullet.resetBasePositionAndOrientation(body, position, orientation)
        self._bullet.resetBaseVelocity(body, (0, 0, 0), (0, 0, 0))

    def speed(self, body: int) -> tuple[float, float]:
        """Return a body's speed (m/s) and rate of turn (rad/s)."""
        linear, angular = self._bullet.getBaseVelocity(body)
        return math.hypot(*linear), math.hypot(*angular)

    def scale_body(self, body: int, links: Iterable[int], mass: float, friction: float) -> None:
        """Multiply the mass, the file's moments of inertia and the friction of a body's links."""
        for link in links:
            known = self._bullet.getDynamicsInfo(body, link)
            self._bullet.changeDynamics(
                body,
                link,
                mass=mass * known[0],
                localInertiaDiagonal=[mass * moment for moment in known[2]],
                lateralFriction=friction * known[1],
            )

    # Joints

    def joint_limits(self, body: int, joint: int) -> tuple[float, float]:
        """Return a joint's range (rad or m)."""
        info = self._bullet.getJointInfo(body, joint)
        return info[8], info[9]

    def set_joint(self, body: int, joint: int, position: float) -> None:
        """Place a joint, at rest."""
        self._bullet.resetJointState(body, joint, position)

    def joint_positions(self, body: int, joints: Sequence[int]) -> list[float]:
        """Return joint positions (rad or m)."""
        return [state[0] for state in self._bullet.getJointStates(body, joints)]

    def sense_joint_forces(self, body: int, joints: Iterable[int]) -> None:
        """Switch on the force sensor of these joints."""
        for joint in joints:
            self._bullet.enableJointForceTorqueSensor(body, joint, True)

    def joint_forces(self, body: int, joints: Sequence[int]) -> list[tuple[float, float, float]]:
        """Return the reaction force (N) at each joint, in the joint's frame."""
        return [state[2][:3] for state in self._bullet.getJointStates(body, joints)]

    def drive_joints(
        self, body: int, joints: Sequence[int], targets: Vector, forces: Vector
    ) -> None:
        """Drive joints towards positions with at most these forces (N or N·m)."""
        self._bullet.setJointMotorControlArray(
            body, joints, pybullet.POSITION_CONTROL, targetPositions=targets, forces=forces
        )

    def set_joint_friction(self, body: int, joint: int, torque: float) -> None:
        """Replace a joint's default motor by dry friction (N or N·m)."""
        self._bullet.setJointMotorControl2(
            body, joint, pybullet.VELOCITY_CONTROL, targetVelocity=0.0, force=torque
        )

    def link_position(self, body: int, link: int) -> tuple[float, float, float]:
        """Return the position (m) of a link's frame as of the last tick."""
        # Positional arguments: this and ``contacts`` run every tick, and keywords cost a third.
        return pybullet.getLinkState(body, link, 0, 0, self._bullet.id)[4]

    def placed_link_position(self, body: int, link: int) -> tuple[float, float, float]:
        """Return the position (m) of a link's frame after joints were placed without a tick."""
        return pybullet.getLinkState(body, link, 0, 1, self._bullet.id)[4]

    def inverse_kinematics(
        self, body: int, link: int, position: Vector, orientation: Vector, movable: int
    ) -> tuple[float, ...]:
        """Return positions of the ``movable`` joints that bring a link to a pose."""
        control = PROTOCOL.control
        return self._bullet.calculateInverseKinematics(
            body,
            link,
            position,
            orientation,
            jointDamping=[control.ik_damping] * movable,
            maxNumIterations=control.ik_iterations,
            residualThreshold=control.ik_residual,
        )

    # Contacts and pictures

    def contacts(self, body_a: int, body_b: int) -> list[Contact]:
        """Return the contact points of the last tick between two bodies."""
        points = pybullet.getContactPoints(body_a, body_b, ANY_LINK, ANY_LINK, self._bullet.id)
        return [Contact(point[3], point[4], point[9]) for point in points]

    def contact_force(self, body: int, link: int) -> tuple[float, float, float]:
        """Return the normal forces (N) that contacts put on a link, summed, in the world."""
        total = [0.0, 0.0, 0.0]
        for point in self._bullet.getContactPoints(bodyA=body, linkIndexA=link):
            normal, force = point[7], point[9]  # the normal points towards ``body``
            for axis in range(3):
                total[axis] += normal[axis] * force
        return total[0], total[1], total[2]

    def link_axis_y(self, body: int, link: int) -> tuple[float, float, float]:
        """Return the y axis of a link's frame in the world."""
        x, y, z, w = pybullet.getLinkState(body, link, 0, 0, self._bullet.id)[5]
        return 2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)

    def render(self, camera: CameraSpec, width: int, height: int, *, bodies: bool = False) -> Image:
        """Render the world in software; ``bodies`` also returns the body at each pixel."""
        _, _, rgba, depth, seen = self._bullet.getCameraImage(
            width,
            height,
            *_matrices(camera, width / height),
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            flags=0 if bodies else pybullet.ER_NO_SEGMENTATION_MASK,
        )
        size = (height, width)
        return Image(
            np.reshape(np.asarray(rgba, np.uint8), (*size, 4))[..., :3],
            np.reshape(np.asarray(depth, np.float32), size),
            np.reshape(np.asarray(seen, np.int32), size) if bodies else np.empty(0, np.int32),
        )
