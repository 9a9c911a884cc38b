"""Inverse kinematics of the Panda as a pure function of the pose asked for."""

import math
from collections.abc import Sequence

from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.simulation.panda_model import light_panda
from minitouch_bench.simulation.values import Pose, Vector

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
        self._body = self._client.load_urdf(light_panda(), fixed=True)
        self._posture = tuple(posture)
        limits = [self._client.joint_limits(self._body, joint) for joint in ARM_JOINTS]
        self._low = [low for low, _ in limits]
        self._high = [high for _, high in limits]

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
        x, y, z = position
        qx, qy, qz, qw = orientation
        solution = self._client.inverse_kinematics(
            self._body,
            END_EFFECTOR,
            Pose((x, y, z), (qx, qy, qz, qw)),
            damping=[CONTROL.ik_damping] * (len(ARM_JOINTS) + len(FINGER_JOINTS)),
            iterations=CONTROL.ik_iterations,
            residual=CONTROL.ik_residual,
        )
        return list(solution[: len(ARM_JOINTS)])

    def within_limits(self, joints: Sequence[float]) -> bool:
        """Tell whether every joint position is finite and inside its joint's range."""
        return all(
            math.isfinite(joint) and low <= joint <= high
            for joint, low, high in zip(joints, self._low, self._high, strict=True)
        )

    def clamp(self, joints: Sequence[float], margin: float = 0.0) -> list[float]:
        """Return the joint positions, each moved into its joint's range less a margin (rad)."""
        return [
            min(max(joint, low + margin), high - margin)
            for joint, low, high in zip(joints, self._low, self._high, strict=True)
        ]
