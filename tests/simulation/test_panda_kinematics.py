import math

import numpy as np
import pytest

from minitouch_bench.protocol.tasks import FACING_DOOR, POINTING_DOWN
from minitouch_bench.simulation.client import PhysicsClient, quaternion_from_euler
from minitouch_bench.simulation.panda_kinematics import ARM_JOINTS, END_EFFECTOR, PandaKinematics
from minitouch_bench.simulation.panda_model import light_panda
from minitouch_bench.simulation.scene import add_table
from minitouch_bench.tasks.registration import TASKS

DOWN = quaternion_from_euler((0.0, -math.pi, math.pi / 2))


def poses(spec, count=40):
    """Return positions in a task's workspace with the gripper's orientation."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        position = rng.uniform(spec.workspace.low, spec.workspace.high)
        yaw = rng.uniform(-math.pi / 4, 0.6)
        door = quaternion_from_euler((yaw, math.pi / 2, 0.0))
        yield tuple(position), door if spec.arm.faces_door else DOWN


@pytest.mark.parametrize("task", TASKS)
def test_every_position_of_the_workspace_is_reached_clear_of_the_table(task):
    spec = TASKS[task].spec
    kinematics, client = PandaKinematics(spec.arm.posture), PhysicsClient()
    table = add_table(client)
    body = client.load_urdf(light_panda(), fixed=True)
    for position, orientation in poses(spec, 200):
        joints = kinematics.solve(position, orientation)
        assert kinematics.within_limits(joints)
        for joint, angle in zip(ARM_JOINTS, joints, strict=True):
            client.set_joint(body, joint, angle)
        assert math.dist(client.placed_link_position(body, END_EFFECTOR), position) < 1e-4
        assert not client.overlapping(body, table, 0.005)
    kinematics.close()
    client.close()


def test_a_solution_depends_on_the_pose_alone():
    wanted = list(poses(TASKS["playing"].spec, 10))
    one, other = (PandaKinematics(POINTING_DOWN.posture) for _ in range(2))
    forwards = [one.solve(*pose) for pose in wanted]
    backwards = [other.solve(*pose) for pose in reversed(wanted)]
    assert forwards == backwards[::-1]
    assert forwards == [one.solve(*pose) for pose in wanted]
    one.close()
    other.close()


def test_joints_are_kept_within_their_limits():
    kinematics = PandaKinematics(FACING_DOOR.posture)
    far = [10.0, -10.0] * 3 + [10.0]
    assert not kinematics.within_limits(far)
    assert kinematics.within_limits(kinematics.clamp(far))
    assert not kinematics.within_limits([math.nan] * 7)
    kinematics.close()
