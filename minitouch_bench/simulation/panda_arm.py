"""The Franka Panda in a world: start poses, one control step, and what its fingers feel."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import ArmSpec
from minitouch_bench.simulation.client import PhysicsClient, quaternion_from_euler
from minitouch_bench.simulation.panda_kinematics import (
    ARM_JOINTS,
    END_EFFECTOR,
    FINGER_JOINTS,
    PandaKinematics,
)
from minitouch_bench.simulation.panda_model import light_panda
from minitouch_bench.simulation.values import Vector

CONTROL = PROTOCOL.control


class PandaArm:
    """A Panda in a world, moved by the benchmark's actions."""

    def __init__(self, client: PhysicsClient, kinematics: PandaKinematics, spec: ArmSpec) -> None:
        self._client = client
        self._kinematics = kinematics
        self._spec = spec
        self.body = client.load_urdf(light_panda(), fixed=True)
        self.yaw = 0.0
        """Commanded yaw of the gripper (rad)."""
        self.gripper_opening = CONTROL.gripper_start
        """The internal opening of a discrete gripper, 0 to 1."""
        client.sense_joint_forces(self.body, FINGER_JOINTS)
        self._place_joints(spec.start_joints[: len(ARM_JOINTS)])

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
            _clamp(now + CONTROL.reach * value, lowest, highest)
            for now, value, lowest, highest in zip(
                self.position, values[:3], low, high, strict=True
            )
        ]
        turn = CONTROL.yaw_reach * values[4] if self._spec.faces_door else 0.0
        self._drive(self._joint_targets(target, turn), self._finger_targets(values[3]))
        for tick in range(CONTROL.max_ticks):
            self._client.step()
            after_tick()
            if math.dist(self.position, target) < CONTROL.tolerance:
                return tick + 1
        return CONTROL.max_ticks

    def _finger_targets(self, value: float) -> list[float]:
        if self._spec.discrete_gripper:
            step = value * CONTROL.finger_reach / CONTROL.finger_open
            self.gripper_opening = _clamp(self.gripper_opening + step, 0.0, 1.0)
            return [
                CONTROL.finger_open if self.gripper_opening >= CONTROL.gripper_threshold else 0.0
            ] * 2
        return [
            _clamp(position + CONTROL.finger_reach * value, 0.0, CONTROL.finger_open)
            for position in self.finger_positions()
        ]

    def _joint_targets(self, target: Vector, turn: float) -> list[float]:
        """Solve for the arm's joints, turning less where the wrist's limits ask for it.

        Towards +45 degrees the wrist meets its limits in parts of Opening's workspace; the
        yaw is then lowered until a solution within the limits exists.
        """
        self.yaw = _clamp(self.yaw + turn, -CONTROL.max_yaw, CONTROL.max_yaw)
        joints = self._solve(target, self.yaw)
        while (
            self._spec.faces_door
            and self.yaw > -CONTROL.max_yaw
            and not self._kinematics.within_limits(joints)
        ):
            self.yaw = max(self.yaw - CONTROL.yaw_backtrack, -CONTROL.max_yaw)
            joints = self._solve(target, self.yaw)
        return self._kinematics.clamp(joints)

    def _solve(self, target: Vector, yaw: float) -> list[float]:
        # Fixed-axis roll, pitch, yaw. Down: the text's Euler (0, -pi, pi/2). Door: a pitch of
        # pi/2 lays the hand flat, and a roll before it turns the fingers in the plane.
        angles = (yaw, math.pi / 2, 0.0) if self._spec.faces_door else (0.0, -math.pi, math.pi / 2)
        return self._kinematics.solve(target, quaternion_from_euler(angles))

    def _place_joints(self, joints: Sequence[float]) -> None:
        fingers = self._spec.start_joints[len(ARM_JOINTS) :]
        for joint, position in zip((*ARM_JOINTS, *FINGER_JOINTS), (*joints, *fingers), strict=True):
            self._client.set_joint(self.body, joint, position)
        self._client.placed_link_position(self.body, END_EFFECTOR)
        self._drive(joints, fingers)

    def _drive(self, joints: Sequence[float], fingers: Sequence[float]) -> None:
        self._client.drive_joints(
            self.body,
            (*ARM_JOINTS, *FINGER_JOINTS),
            (*joints, *fingers),
            (*[CONTROL.arm_force] * len(ARM_JOINTS), *self._spec.finger_forces),
        )


def _clamp(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
