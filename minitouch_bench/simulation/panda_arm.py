"""The Franka Panda: its inverse kinematics, start poses, one control step, and finger forces."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import ArmSpec
from minitouch_bench.simulation.bodies import PANDA
from minitouch_bench.simulation.client import PhysicsClient, Vector, quaternion_from_euler

ARM_JOINTS = (0, 1, 2, 3, 4, 5, 6)
FINGER_JOINTS = (9, 10)
"""Left and right finger; the same numbers name the finger links."""
END_EFFECTOR = 11
"""The grasp-target link, between the fingertips."""

CONTROL = PROTOCOL.control


class PandaKinematics:
    """Solve for joint positions in a world of its own, where the arm rests in one posture.

    Every solution starts from that posture, so it depends on the pose alone: the seventh
    degree of freedom cannot drift over an episode until a joint meets its limit, as it does
    when each solution starts from the last one.
    """

    def __init__(self, posture: Sequence[float]) -> None:
        self._client = PhysicsClient()
        self._body = self._client.load_urdf(PANDA, fixed=True)
        self._posture = tuple(posture)
        limits = [self._client.joint_limits(self._body, joint) for joint in ARM_JOINTS]
        self._low, self._high = np.transpose(limits)

    def close(self) -> None:
        """Free the solver's world."""
        self._client.close()

    def solve(self, position: Vector, orientation: Vector) -> list[float]:
        """Return the seven joint positions (rad) that bring the end effector to a pose.

        Where the first solution leaves a joint's range, the joints are moved into their ranges
        and the next solution starts from there: the arm's free motion absorbs the rest. The
        result may still lie outside; see ``within_limits``.
        """
        joints = self._solve_from(self._posture, position, orientation)
        for _ in range(CONTROL.ik_projections):
            if self.within_limits(joints):
                break
            inside = self.clamp(joints, CONTROL.ik_limit_margin)
            joints = self._solve_from(inside, position, orientation)
        return joints

    def _solve_from(
        self, start: Sequence[float], position: Vector, orientation: Vector
    ) -> list[float]:
        for joint, value in zip(ARM_JOINTS, start, strict=True):
            self._client.set_joint(self._body, joint, value)
        movable = len(ARM_JOINTS) + len(FINGER_JOINTS)
        solution = self._client.inverse_kinematics(
            self._body, END_EFFECTOR, position, orientation, movable
        )
        return list(solution[: len(ARM_JOINTS)])

    def within_limits(self, joints: Sequence[float]) -> bool:
        """Tell whether every joint position is inside its joint's range; NaN is not."""
        return bool(((self._low <= joints) & (joints <= self._high)).all())

    def clamp(self, joints: Sequence[float], margin: float = 0.0) -> list[float]:
        """Return the joint positions, each moved into its joint's range less a margin (rad)."""
        inside: list[float] = np.clip(joints, self._low + margin, self._high - margin).tolist()
        return inside


class PandaArm:
    """A Panda in a world, moved by the benchmark's actions."""

    def __init__(self, client: PhysicsClient, kinematics: PandaKinematics, spec: ArmSpec) -> None:
        self._client = client
        self._kinematics = kinematics
        self._spec = spec
        self.body = client.load_urdf(PANDA, fixed=True)
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
        self, action: NDArray[np.float32], low: Vector, high: Vector, after_tick: Callable[[], None]
    ) -> int:
        """Carry out one control step and return its number of ticks.

        ``action`` float32 (4,) or (5,), finite and in [-1, 1]. The target is the present
        position plus 0.06 m times ``action[0:3]``, kept between ``low`` and ``high`` (m).

        Inverse kinematics runs once a step. Solved well it leaves the end effector within
        0.1 mm of its target, where the usual solution at every tick stays 1 mm short.
        """
        values = action.astype(np.float64)
        target = np.clip(self.position + CONTROL.reach * values[:3], low, high).tolist()
        turn = CONTROL.yaw_reach * float(values[4]) if self._spec.faces_door else 0.0
        self._drive(self._joint_targets(target, turn), self._finger_targets(float(values[3])))
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
            (*[CONTROL.arm_force] * len(ARM_JOINTS), *self._spec.motor_force),
        )


def _clamp(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
