"""The Franka Panda in a world: start poses, one control step, and what its fingers feel."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.simulation.arm_assets import light_panda
from minitouch_bench.simulation.client import PhysicsClient, quaternion_from_euler
from minitouch_bench.simulation.panda_kinematics import (
    ARM_JOINTS,
    END_EFFECTOR,
    FINGER_JOINTS,
    PandaKinematics,
)
from minitouch_bench.simulation.values import Vector

# Constants of the released MiniTouch package, unless a docstring says otherwise.
REACH_M = 0.06
"""Offset of the end effector per unit of action."""
FINGER_REACH_M = 0.075
"""Change of each finger's target per unit of action."""
FINGER_OPEN_M = 0.04
"""Upper end of a finger joint."""
YAW_REACH_RAD = 0.3
"""Change of the gripper's yaw per unit of action."""
MAX_YAW_RAD = math.pi / 4
YAW_BACKTRACK_RAD = 0.05
"""Step in which the yaw is lowered where the wrist meets its limits. Ours."""
TOLERANCE_M = 1e-4
"""A control step ends when the end effector is this close to its target."""
MAX_TICKS = 100
"""A control step ends after this many ticks in any case."""
ARM_FORCE = 500.0
"""Largest motor force of the arm's joints (N·m)."""


@dataclass(frozen=True)
class ArmPreset:
    """How a task holds the Panda.

    ``start_joints``: seven arm joints (rad) and two fingers (m). ``posture``: the seven arm
    joints (rad) that inverse kinematics starts from, chosen for the distance to the joint
    limits over the whole workspace. ``finger_forces``: left and right motor (N).
    """

    start_joints: tuple[float, ...]
    posture: tuple[float, ...]
    faces_door: bool = False
    finger_forces: tuple[float, float] = (25.0, 20.0)
    discrete_gripper: bool = False

    @property
    def action_size(self) -> int:
        """4 numbers (dx, dy, dz, finger); 5 where the gripper can turn."""
        return 5 if self.faces_door else 4


POINTING_DOWN = ArmPreset(
    start_joints=(-0.028, 0.853, -0.016, -1.547, 0.017, 2.4, 2.305, 0.0, 0.0),
    posture=(0.03, 1.06, 0.23, -1.89, 0.52, 2.64, 2.21),
)
START_XY = (0.700, -0.029)
"""Where the end effector of ``POINTING_DOWN`` starts (m), at a height of 0.039 m."""

FACING_DOOR = ArmPreset(
    start_joints=(-0.747, 1.465, 0.968, -2.182, 2.856, 1.649, -0.220, 0.0, 0.0),
    posture=(-1.5, 1.296, 1.603, -1.97, 2.059, 2.732, -0.031),
    faces_door=True,
    discrete_gripper=True,
)


class PandaArm:
    """A Panda in a world, moved by the benchmark's actions."""

    def __init__(
        self, client: PhysicsClient, kinematics: PandaKinematics, preset: ArmPreset
    ) -> None:
        self._client = client
        self._kinematics = kinematics
        self._preset = preset
        self.body = client.load_urdf(light_panda(), fixed=True)
        self.yaw = 0.0
        """Commanded yaw of the gripper (rad)."""
        self.gripper_opening = 1.0
        """The internal opening of a discrete gripper, 0 to 1."""
        client.sense_joint_forces(self.body, FINGER_JOINTS)
        self._place_joints(preset.start_joints[: len(ARM_JOINTS)])

    @property
    def position(self) -> tuple[float, float, float]:
        """End-effector position (m)."""
        return self._client.link_position(self.body, END_EFFECTOR)

    def finger_positions(self) -> list[float]:
        """Return the positions of the finger joints, left and right (m)."""
        return self._client.joint_positions(self.body, FINGER_JOINTS)

    def finger_forces(self) -> list[tuple[float, float, float]]:
        """Return the forces at the finger joints, left and right (N), in the finger's frame.

        x and z: the joint's reaction. PyBullet's reaction leaves out y, the axis along which the
        fingers close, because the motor drives it; there, the contacts' normal forces stand in,
        with the reaction's sign: what the hand puts against them.
        """
        reactions = self._client.joint_forces(self.body, FINGER_JOINTS)
        axis = self._client.link_axis_y(self.body, FINGER_JOINTS[0])
        forces = []
        for joint, (x, _, z) in zip(FINGER_JOINTS, reactions, strict=True):
            contact = self._client.contact_force(self.body, joint)
            forces.append((x, -sum(a * b for a, b in zip(axis, contact, strict=True)), z))
        return forces

    def place(self, target: Vector) -> None:
        """Put the end effector at ``target`` (m) at once, at rest: for resets only."""
        self._place_joints(self._kinematics.clamp(self._solve(target, self.yaw)))

    def move(
        self,
        action: NDArray[np.float32],
        low: Vector,
        high: Vector,
        after_tick: Callable[[], None],
    ) -> int:
        """Carry out one control step and return its number of ticks.

        ``action`` float32 (4,) or (5,), finite and in [-1, 1]. The target is the present
        position plus 0.06 m times ``action[0:3]``, kept between ``low`` and ``high`` (m).

        Inverse kinematics runs once a step. Solved well it leaves the end effector within
        0.1 mm of its target, where the usual solution at every tick stays 1 mm short.
        """
        values = [float(value) for value in action]
        target = [
            _clamp(now + REACH_M * value, lowest, highest)
            for now, value, lowest, highest in zip(
                self.position, values[:3], low, high, strict=True
            )
        ]
        turn = YAW_REACH_RAD * values[4] if self._preset.faces_door else 0.0
        self._drive(self._joint_targets(target, turn), self._finger_targets(values[3]))
        for tick in range(MAX_TICKS):
            self._client.step()
            after_tick()
            if math.dist(self.position, target) < TOLERANCE_M:
                return tick + 1
        return MAX_TICKS

    def _finger_targets(self, value: float) -> list[float]:
        if self._preset.discrete_gripper:
            step = value * FINGER_REACH_M / FINGER_OPEN_M
            self.gripper_opening = _clamp(self.gripper_opening + step, 0.0, 1.0)
            return [FINGER_OPEN_M if self.gripper_opening >= 0.5 else 0.0] * 2
        return [
            _clamp(position + FINGER_REACH_M * value, 0.0, FINGER_OPEN_M)
            for position in self.finger_positions()
        ]

    def _joint_targets(self, target: Vector, turn: float) -> list[float]:
        """Solve for the arm's joints, turning less where the wrist's limits ask for it.

        Towards +45 degrees the wrist meets its limits in parts of Opening's workspace; the
        yaw is then lowered until a solution within the limits exists.
        """
        self.yaw = _clamp(self.yaw + turn, -MAX_YAW_RAD, MAX_YAW_RAD)
        joints = self._solve(target, self.yaw)
        while (
            self._preset.faces_door
            and self.yaw > -MAX_YAW_RAD
            and not self._kinematics.within_limits(joints)
        ):
            self.yaw = max(self.yaw - YAW_BACKTRACK_RAD, -MAX_YAW_RAD)
            joints = self._solve(target, self.yaw)
        return self._kinematics.clamp(joints)

    def _solve(self, target: Vector, yaw: float) -> list[float]:
        # Fixed-axis roll, pitch, yaw. Down: the text's Euler (0, -pi, pi/2). Door: a pitch of
        # pi/2 lays the hand flat, and a roll before it turns the fingers in the plane.
        angles = (
            (yaw, math.pi / 2, 0.0) if self._preset.faces_door else (0.0, -math.pi, math.pi / 2)
        )
        return self._kinematics.solve(target, quaternion_from_euler(angles))

    def _place_joints(self, joints: Sequence[float]) -> None:
        fingers = self._preset.start_joints[len(ARM_JOINTS) :]
        for joint, position in zip((*ARM_JOINTS, *FINGER_JOINTS), (*joints, *fingers), strict=True):
            self._client.set_joint(self.body, joint, position)
        self._client.placed_link_position(self.body, END_EFFECTOR)
        self._drive(joints, fingers)

    def _drive(self, joints: Sequence[float], fingers: Sequence[float]) -> None:
        self._client.drive_joints(
            self.body,
            (*ARM_JOINTS, *FINGER_JOINTS),
            (*joints, *fingers),
            (*[ARM_FORCE] * len(ARM_JOINTS), *self._preset.finger_forces),
        )


def _clamp(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
