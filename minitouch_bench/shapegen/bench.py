"""A small PyBullet world of its own, to prove that a body rests still and can be lifted."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pybullet
import pybullet_data

from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.shapegen.files import body_files
from minitouch_bench.shapegen.grasps import plan_grasp
from minitouch_bench.shapegen.mesh import Points
from minitouch_bench.shapegen.poses import Quaternion, RestPose, product, rotation_matrix, yaw
from minitouch_bench.shapegen.record import Body

GRAVITY = -9.8
FINGER_FORCE = 60.0
"""Force of each finger in N, as in Pick-up."""
HAND_ABOVE_TARGET = 0.105
LIFT = 0.08
SETTLE_TICKS, WATCH_TICKS = 300, 60
CLOSE_TICKS, LIFT_TICKS, HOLD_TICKS = 60, 120, 30

_GRIPPER = """<?xml version="1.0"?>
<robot name="gripper">
  <link name="post"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1"
    iyz="0" izz="1"/></inertial></link>
  <link name="hand"><inertial><mass value="0.8"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1"
    iyz="0" izz="0.1"/></inertial>
    <collision><origin xyz="0 0 0.033"/><geometry><box size="0.063 0.204 0.066"/></geometry>
    </collision></link>
  <joint name="lift" type="prismatic"><parent link="post"/><child link="hand"/>
    <axis xyz="0 0 -1"/><limit lower="-1" upper="1" effort="1000" velocity="1"/></joint>
  {fingers}
</robot>
"""
_FINGER = """<link name="{name}">
    <contact><friction_anchor/><stiffness value="30000.0"/><damping value="1000.0"/>
      <spinning_friction value="0.1"/><lateral_friction value="1.0"/></contact>
    <inertial><mass value="0.1"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/>
    </inertial>
    <collision><origin xyz="0 0 0" rpy="0 0 {turn}"/><geometry><mesh filename="{mesh}"/>
    </geometry></collision></link>
  <joint name="{name}_slide" type="prismatic"><parent link="hand"/><child link="{name}"/>
    <origin xyz="0 0 0.0584"/><axis xyz="0 {side} 0"/>
    <limit lower="0" upper="0.04" effort="100" velocity="0.2"/></joint>
"""


@dataclass(frozen=True)
class Rest:
    """How a body lay after settling: where, how fast it still moved, how deep it sank.

    ``tilt`` from the pose it was laid in, rad; speeds in m/s and rad/s; ``gap`` between its
    lowest point and the table in m, negative below it.
    """

    quaternion: Quaternion
    height: float
    tilt: float
    speed: float
    spin: float
    gap: float


class Bench:
    """One body's files and one DIRECT client; every trial rebuilds the world from nothing."""

    def __init__(self, client: int, folder: Path, body: Body) -> None:
        """Write the body and the gripper into a folder."""
        self._client = client
        files = body_files(body)
        for name, content in files.contents.items():
            (folder / name).write_bytes(content)
        self._urdf = str(folder / files.urdf_name)
        self._gripper = str(folder / "gripper.urdf")
        mesh = Path(pybullet_data.getDataPath()) / "franka_panda/meshes/collision/finger.obj"
        fingers = "".join(
            _FINGER.format(name=name, turn=turn, side=side, mesh=mesh)
            for name, turn, side in (("left", 0.0, 1), ("right", np.pi, -1))
        )
        (folder / "gripper.urdf").write_text(_GRIPPER.format(fingers=fingers))
        self._vertices = np.concatenate([hull.vertices for hull in body.hulls])

    def settle(self, pose: RestPose) -> Rest:
        """Lay the body down tilted by 2 degrees, 1 mm above the table, and wait 1.5 s."""
        start = product((float(np.sin(np.pi / 180)), 0.0, 0.0, float(np.cos(np.pi / 180))),
                        pose.quaternion)  # fmt: skip
        lowest = float((self._vertices @ rotation_matrix(start)[2]).min())
        body = self._fresh_world(start, 0.002 - lowest)
        for _ in range(SETTLE_TICKS):
            pybullet.stepSimulation(physicsClientId=self._client)
        speed = spin = 0.0
        for _ in range(WATCH_TICKS):
            pybullet.stepSimulation(physicsClientId=self._client)
            velocity = pybullet.getBaseVelocity(body, physicsClientId=self._client)
            speed = max(speed, float(np.linalg.norm(velocity[0])))
            spin = max(spin, float(np.linalg.norm(velocity[1])))
        position, quaternion = self._pose_of(body)
        rotation = rotation_matrix(quaternion)
        cosine = float(rotation[2] @ rotation_matrix(pose.quaternion)[2])
        gap = position[2] + float((self._vertices @ rotation[2]).min())
        return Rest(quaternion, position[2], float(np.arccos(min(1.0, cosine))), speed, spin, gap)

    def lift(self, pose: RestPose, angle: float, surface: Points) -> bool:
        """Grip the body at a yaw with free-standing Panda fingers and raise it; true if it came.

        ``surface``: dense points of the body in its own frame, (N, 3) m.
        """
        turned = product(yaw(angle), pose.quaternion)
        grasp = plan_grasp(surface @ rotation_matrix(turned).T + [0.0, 0.0, pose.height])
        if not np.isfinite(grasp.width):
            return False
        body = self._fresh_world(turned, pose.height)
        gripper = pybullet.loadURDF(
            self._gripper,
            [grasp.x, grasp.y, grasp.z + HAND_ABOVE_TARGET],
            [1.0, 0.0, 0.0, 0.0],
            useFixedBase=True,
            physicsClientId=self._client,
        )
        for finger in (1, 2):
            pybullet.resetJointState(gripper, finger, 0.04, physicsClientId=self._client)
        for tick in range(CLOSE_TICKS + LIFT_TICKS + HOLD_TICKS):
            share = min(1.0, max(0.0, (tick - CLOSE_TICKS) / LIFT_TICKS))
            pybullet.setJointMotorControlArray(
                gripper,
                [0, 1, 2],
                pybullet.POSITION_CONTROL,
                targetPositions=[share * LIFT, 0.0, 0.0],
                forces=[1000.0, FINGER_FORCE, FINGER_FORCE],
                physicsClientId=self._client,
            )
            pybullet.stepSimulation(physicsClientId=self._client)
        position, quaternion = self._pose_of(body)
        lowest = position[2] + float((self._vertices @ rotation_matrix(quaternion)[2]).min())
        return lowest >= 0.05

    def _fresh_world(self, quaternion: Quaternion, height: float) -> int:
        """Rebuild the world in one fixed order: PyBullet repeats itself to the bit only then."""
        client = self._client
        pybullet.resetSimulation(physicsClientId=client)
        pybullet.setPhysicsEngineParameter(
            deterministicOverlappingPairs=1,
            fixedTimeStep=1.0 / PROTOCOL.physics.tick_rate,
            physicsClientId=client,
        )
        pybullet.setGravity(0.0, 0.0, GRAVITY, physicsClientId=client)
        slab = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=[0.5, 0.5, 0.05], physicsClientId=client
        )
        pybullet.createMultiBody(0, slab, -1, [0.0, 0.0, -0.05], physicsClientId=client)
        return int(
            pybullet.loadURDF(
                self._urdf,
                [0.0, 0.0, height],
                quaternion,
                flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=client,
            )
        )

    def _pose_of(self, body: int) -> tuple[tuple[float, float, float], Quaternion]:
        position, quaternion = pybullet.getBasePositionAndOrientation(
            body, physicsClientId=self._client
        )
        return position, quaternion


@contextmanager
def open_bench(body: Body) -> Iterator[Bench]:
    """Yield a bench for a body, and close its client and remove its files afterwards."""
    client = pybullet.connect(pybullet.DIRECT)
    try:
        with tempfile.TemporaryDirectory(prefix="minitouch-bench-") as folder:
            yield Bench(client, Path(folder), body)
    finally:
        pybullet.disconnect(physicsClientId=client)
