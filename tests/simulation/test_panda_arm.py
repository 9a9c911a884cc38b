import math

import numpy as np
import pytest

from minitouch_bench.protocol.minitouch import FACING_DOOR, POINTING_DOWN
from minitouch_bench.simulation.bodies import PANDA, add_table
from minitouch_bench.simulation.client import PhysicsClient, quaternion_from_euler
from minitouch_bench.simulation.panda_arm import (
    ARM_JOINTS,
    END_EFFECTOR,
    FINGER_JOINTS,
    PandaArm,
    PandaKinematics,
)
from minitouch_bench.tasks.task import TASK_CLASSES
from tests.tasks.playback import overlapping

DOWN = quaternion_from_euler((0.0, -math.pi, math.pi / 2))


def poses(spec, count):
    """Return positions in a task's workspace with the gripper's orientation."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        position = rng.uniform(spec.workspace.low, spec.workspace.high)
        yaw = rng.uniform(-math.pi / 4, 0.6)
        door = quaternion_from_euler((yaw, math.pi / 2, 0.0))
        yield tuple(position), door if spec.arm.faces_door else DOWN


@pytest.mark.parametrize("task", TASK_CLASSES)
def test_every_position_of_the_workspace_is_reached_clear_of_the_table(task):
    spec = TASK_CLASSES[task].spec
    kinematics, client = PandaKinematics(spec.arm.posture), PhysicsClient()
    table = add_table(client)
    body = client.load_urdf(PANDA, fixed=True)
    for position, orientation in poses(spec, 200):
        joints = kinematics.solve(position, orientation)
        assert kinematics.within_limits(joints)
        for joint, angle in zip(ARM_JOINTS, joints, strict=True):
            client.set_joint(body, joint, angle)
        assert math.dist(client.placed_link_position(body, END_EFFECTOR), position) < 1e-4
        assert not overlapping(client, body, table, 0.005)


def test_a_solution_depends_on_the_pose_alone():
    wanted = list(poses(TASK_CLASSES["playing"].spec, 10))
    one, other = (PandaKinematics(POINTING_DOWN.posture) for _ in range(2))
    forwards = [one.solve(*pose) for pose in wanted]
    backwards = [other.solve(*pose) for pose in reversed(wanted)]
    assert forwards == backwards[::-1]
    assert forwards == [one.solve(*pose) for pose in wanted]


def test_joints_are_kept_within_their_limits():
    kinematics = PandaKinematics(FACING_DOOR.posture)
    far = [10.0, -10.0] * 3 + [10.0]
    assert not kinematics.within_limits(far)
    assert kinematics.within_limits(kinematics.clamp(far))
    assert not kinematics.within_limits([math.nan] * 7)


CLEAR_M = {"playing": 0.03, "pushing": 0.03, "pick-up": 0.03, "opening": 0.12}
"""Height above which neither fingers nor forearm can meet the table."""
LIMIT_SLACK = 1e-3
"""What a joint may overshoot its limit by, rad or m: limits are soft in the simulator."""


class Bench:
    """An arm alone over the table, held as a task holds it."""

    def __init__(self, task):
        self.spec = TASK_CLASSES[task].spec
        self.client = PhysicsClient()
        add_table(self.client)
        self.kinematics = PandaKinematics(self.spec.arm.posture)
        self.arm = PandaArm(self.client, self.kinematics, self.spec.arm)
        self.rng = np.random.default_rng(1)

    def random_action(self, low=-1.0):
        size = self.spec.action_size
        return self.rng.uniform(low, 1.0, size).astype(np.float32)

    def move(self, action):
        space = self.spec.workspace
        return self.arm.move(action, space.low, space.high, lambda: None)

    def move_clear_of_the_table(self):
        """Make a random move and return its miss (m) and its ticks; yaw only one way."""
        low, high = np.array(self.spec.workspace.low), np.array(self.spec.workspace.high)
        low[2] = CLEAR_M[self.spec.name]
        action = self.random_action()
        action[4:] = -np.abs(action[4:])
        target = np.clip(self.arm.position + 0.06 * action[:3], low, high)
        ticks = self.arm.move(action, low, high, lambda: None)
        return math.dist(self.arm.position, target), ticks

    def overshoot(self, joints):
        """Return how far the joints are outside their ranges (rad or m), 0 if inside."""
        limits = np.array([self.client.joint_limits(self.arm.body, joint) for joint in joints])
        now = np.array(self.client.joint_positions(self.arm.body, joints))
        assert np.all(np.isfinite(now))
        return max(0.0, *(limits[:, 0] - now), *(now - limits[:, 1]))


@pytest.fixture(params=list(TASK_CLASSES))
def bench(request):
    return Bench(request.param)


def test_the_end_effector_reaches_its_target_in_free_space(bench):
    for _ in range(3):
        bench.move_clear_of_the_table()  # a task may start outside its workspace
    misses = []
    for _ in range(100):
        miss, ticks = bench.move_clear_of_the_table()
        misses.append(miss)
        assert 1 <= ticks <= 100
        assert bench.overshoot(FINGER_JOINTS) < LIMIT_SLACK
    assert np.quantile(misses, 0.98) < 1e-4
    assert max(misses) < 2e-4


def test_joints_stay_within_their_limits_and_the_hand_in_the_workspace(bench):
    for _ in range(300):
        bench.move(bench.random_action())
        assert bench.overshoot(ARM_JOINTS) < LIMIT_SLACK
    for _ in range(30):
        bench.move(bench.random_action(low=0.3))
    inside = np.clip(bench.arm.position, bench.spec.workspace.low, bench.spec.workspace.high)
    assert math.dist(bench.arm.position, inside) < 2e-3
