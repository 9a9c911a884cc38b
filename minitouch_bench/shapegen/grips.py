"""Where to grip a body, and a free gripper to prove that it lies still and can be lifted."""

import itertools
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pybullet_data

from minitouch_bench.protocol.minitouch import PICK_UP, PLAYING, PROTOCOL, PUSHING
from minitouch_bench.shapegen import geometry
from minitouch_bench.shapegen.body_codec import Body, body_files
from minitouch_bench.simulation.client import INVISIBLE, PhysicsClient

PAD_HALF_WIDTH = 0.0105
"""Half the width of the Panda's finger along x, m."""
TIP_BELOW_TARGET = 0.0072
"""Fingertip below the grasp-target link, m."""
PAD_ABOVE_TARGET = 0.011
"""Upper edge of the flat pad above the grasp-target link, m."""
RECESS = 0.0025
"""How far the finger stands back above its pad, m, on each side."""
PALM_ABOVE_TARGET = 0.039
"""Underside of the hand above the grasp-target link, m."""
LOWEST_TARGET = 0.0112
"""Grasp-target height that keeps the fingertips 4 mm above the table, m."""
FINGER_OPEN = PROTOCOL.control.finger_open
WIDEST_GRIP = 2.0 * FINGER_OPEN
"""Distance between the open pads, m."""
DEEP = 0.012
"""How far above the fingertips a body should reach between the pads, m."""
TRIED_NEAR = 0.004
TRIED_COST = 0.02
"""What a place this near one that was tried before costs, m."""

SLAB_HALF_EXTENTS, SLAB_CENTER = (0.5, 0.5, 0.05), (0.0, 0.0, -0.05)
SLAB_FRICTION = 0.5
POST, FINGERS = 0, (1, 2)
"""The gripper's joints: the one that lifts it, and its fingers."""
GRIPPER_FORCES = (1000.0, *PICK_UP.arm.motor_force)
"""Most force of each joint in N; the fingers' as in Pick-up."""
PADS_DOWN = (1.0, 0.0, 0.0, 0.0)
HAND_ABOVE_TARGET = 0.105
LIFT = 0.08
SETTLE_TICKS, WATCH_TICKS = 300, 60
CLOSE_TICKS, LIFT_TICKS, HOLD_TICKS = 60, 120, 30

GRIPPER = Path(__file__).with_name("gripper.urdf")
"""A hand that a post lifts, with the Panda's fingers: a template of what the protocol says."""


@dataclass(frozen=True)
class Grasp:
    """A grasp target: offset in x, y and height; ``width`` between the pads, inf for none; m."""

    x: float
    y: float
    z: float
    width: float


def plan_grasp(
    points: geometry.Points,
    lowest_target: float = LOWEST_TARGET,
    tried: Sequence[float] = (),
    *,
    deep: bool = False,
) -> Grasp:
    """Choose the best grasp of a resting body by pads that close along y.

    ``points``: dense surface points (N, 3), m, x and y from the center of mass, z from the
    table. Prefers a narrow place near the center of mass with contacts opposite each other,
    ``deep`` between the pads, and not at x of earlier grasps that were ``tried``, m.
    ``lowest_target``: the least height of the grasp target over the table, m. Shapes are proven
    with the defaults: another choice would make another set of the same seed.
    """
    bottom, top = float(points[:, 2].min()), float(points[:, 2].max())
    middle = (bottom + top) / 2.0
    if not deep:
        middle = max(middle, LOWEST_TARGET)
    # Clear of the palm.
    lowest = max(lowest_target, top + 0.003 - PALM_ABOVE_TARGET)
    heights = sorted({max(lowest, middle + step) for step in (-0.008, 0.0, 0.008)})
    best, best_score = Grasp(0.0, 0.0, lowest, float("inf")), float("inf")
    for z in heights:
        for x in np.arange(-0.018, 0.0181, 0.003).tolist():
            grasp, score = _rated(points, x, z, DEEP if deep else -np.inf)
            score += TRIED_COST * sum(abs(x - before) < TRIED_NEAR for before in tried)
            if score < best_score:
                best, best_score = grasp, score
    return best


def _rated(points: geometry.Points, x: float, z: float, depth: float) -> tuple[Grasp, float]:
    """Return the grasp at a strip and height, and its score in m: less is better."""
    strip = points[np.abs(points[:, 0] - x) <= PAD_HALF_WIDTH]
    strip = strip[strip[:, 2] >= z - TIP_BELOW_TARGET - 0.002]
    pad = strip[strip[:, 2] <= z + PAD_ABOVE_TARGET]
    impossible = Grasp(x, 0.0, z, float("inf")), float("inf")
    if len(pad) < 2:
        return impossible
    low, high = float(pad[:, 1].min()), float(pad[:, 1].max())
    wide_low = min(low, float(strip[:, 1].min()) + RECESS)
    wide_high = max(high, float(strip[:, 1].max()) - RECESS)
    width = wide_high - wide_low
    if width > WIDEST_GRIP - 0.006:
        return impossible
    left, right = pad[pad[:, 1] <= low + 0.0015], pad[pad[:, 1] >= high - 0.0015]
    across = left.mean(axis=0) - right.mean(axis=0)
    ends = 0.5 * np.abs(left.mean(axis=0) + right.mean(axis=0))
    shallow = max(0.0, depth + z - TIP_BELOW_TARGET - float(pad[:, 2].max()))
    overhang = (low - wide_low) + (wide_high - high)
    score = 0.3 * width + abs(float(across[0])) + abs(float(across[2])) + 0.8 * float(ends[0])
    score += 3.0 * (overhang + shallow)
    return Grasp(x, (wide_low + wide_high) / 2.0, z, width), score


@dataclass(frozen=True)
class Rest:
    """How a body lay after settling: where, how fast it still moved, how deep it sank.

    ``tilt`` from the pose it was laid in, rad; speeds in m/s and rad/s; ``gap`` between its
    lowest point and the table in m, negative below it.
    """

    quaternion: geometry.Quaternion
    height: float
    tilt: float
    speed: float
    spin: float
    gap: float


class GripRig:
    """One body's files and one simulator; every trial rebuilds the world from nothing."""

    def __init__(self, client: PhysicsClient, folder: Path, body: Body) -> None:
        """Write the body and the gripper into a folder."""
        self._client = client
        files = body_files(body)
        for name, content in files.items():
            (folder / name).write_bytes(content)
        *_, urdf = files
        self._urdf = folder / urdf
        self._gripper = folder / "gripper.urdf"
        text = GRIPPER.read_text("utf-8").format(
            mesh=Path(pybullet_data.getDataPath()) / "franka_panda/meshes/collision/finger.obj",
            opening=FINGER_OPEN,
            stiffness=PROTOCOL.physics.finger_stiffness,
            damping=PROTOCOL.physics.finger_damping,
        )
        self._gripper.write_text(text)
        self._vertices = np.concatenate([hull.vertices for hull in body.hulls])

    def settle(self, pose: geometry.RestPose) -> Rest:
        """Lay the body down tilted by 2 degrees, 1 mm above the table, and wait 1.5 s."""
        tilt = (float(np.sin(np.pi / 180)), 0.0, 0.0, float(np.cos(np.pi / 180)))
        start = geometry.product(tilt, pose.quaternion)
        body = self._fresh_world(start, 0.002 - self._lowest(start))
        for _ in range(SETTLE_TICKS):
            self._client.step()
        speed = spin = 0.0
        for _ in range(WATCH_TICKS):
            self._client.step()
            linear, angular = self._client.speed(body)
            speed, spin = max(speed, linear), max(spin, angular)
        position, quaternion = self._client.pose(body)
        cosine = float(geometry.rotation_matrix(quaternion)[2] @ pose.rotation[2])
        gap = position[2] + self._lowest(quaternion)
        return Rest(quaternion, position[2], float(np.arccos(min(1.0, cosine))), speed, spin, gap)

    def lift(self, pose: geometry.RestPose, angle: float, surface: geometry.Points) -> bool:
        """Grip a body at a yaw and raise it; true if it came. ``surface``: points (N, 3), m."""
        turned = geometry.product(geometry.yaw(angle), pose.quaternion)
        grasp = plan_grasp(surface @ geometry.rotation_matrix(turned).T + [0.0, 0.0, pose.height])
        if not np.isfinite(grasp.width):
            return False
        body = self._fresh_world(turned, pose.height)
        above = (grasp.x, grasp.y, grasp.z + HAND_ABOVE_TARGET)
        gripper = self._client.load_urdf(self._gripper, above, PADS_DOWN, fixed=True)
        for finger in FINGERS:
            self._client.set_joint(gripper, finger, FINGER_OPEN)
        for tick in range(CLOSE_TICKS + LIFT_TICKS + HOLD_TICKS):
            share = min(1.0, max(0.0, (tick - CLOSE_TICKS) / LIFT_TICKS))
            targets = (share * LIFT, 0.0, 0.0)
            self._client.drive_joints(gripper, (POST, *FINGERS), targets, GRIPPER_FORCES)
            self._client.step()
        position, quaternion = self._client.pose(body)
        return position[2] + self._lowest(quaternion) >= PICK_UP.lift

    def visible_pixels(self, pose: geometry.RestPose) -> int:
        """Return how many pixels of a policy's image show the body where it is seen worst."""
        body = self._fresh_world(pose.quaternion, pose.height)
        counts = []
        for spec in (PLAYING, PUSHING, PICK_UP):
            (low_x, low_y, _), (high_x, high_y, _) = spec.workspace.low, spec.workspace.high
            for x, y in itertools.product((low_x, high_x), (low_y, high_y)):
                target = np.subtract(spec.camera.target, (x, y, PROTOCOL.physics.table_top))
                camera = replace(spec.camera, target=tuple(target.tolist()))
                size = PROTOCOL.observation.image_size
                image = self._client.render(camera, size, size, bodies=True)
                counts.append(np.count_nonzero(image.bodies == body))
        return int(min(counts))

    def _lowest(self, quaternion: geometry.Quaternion) -> float:
        """Return how far the lowest corner of a turned body is above its origin, in m."""
        return float((self._vertices @ geometry.rotation_matrix(quaternion)[2]).min())

    def _fresh_world(self, quaternion: geometry.Quaternion, height: float) -> int:
        """Rebuild the world in one fixed order: PyBullet repeats itself to the bit only then."""
        client = self._client
        client.reset_world()
        client.add_box(SLAB_HALF_EXTENTS, SLAB_CENTER, INVISIBLE, friction=SLAB_FRICTION)
        position = (0.0, 0.0, height)
        return client.load_urdf(self._urdf, position, quaternion, inertia_from_file=True)


@contextmanager
def open_rig(body: Body) -> Iterator[GripRig]:
    """Yield a rig for a body, and close its simulator and remove its files afterwards."""
    with (
        closing(PhysicsClient()) as client,
        tempfile.TemporaryDirectory(prefix="minitouch-bench-") as folder,
    ):
        yield GripRig(client, Path(folder), body)
