"""The protocol ``minitouch-v1``: one frozen value, and the seeds of its episodes.

Letters: T text of the paper, R the released package, D ours; ``docs/reference/protocol.md`` gives
the fact behind every R and the reason of every D. An episode's seed is a function of what the
episode is, and of nothing else.
"""

import hashlib
import json
import math

import numpy as np

from minitouch_bench.protocol.spec import (
    ControlSpec,
    ObservationSpec,
    PhysicsSpec,
    ProtocolSpec,
)
from minitouch_bench.protocol.tasks import SUITE_SPECS, TASK_SPECS

PROTOCOL = ProtocolSpec(
    name="minitouch-v1",
    seeds=2,
    physics=PhysicsSpec(
        simulator="pybullet 3.2.7",  # D
        tick_rate=240,  # R
        gravity=-9.8,  # R
        table_top=-0.025,  # R
        table_center=(0.5, 0.0),  # R
        table_half_extents=(1.0, 1.0, 0.05),  # D
        table_friction=1.0,  # R
        finger_stiffness=300_000.0,  # R
        finger_damping=1_000.0,  # R
        arm_meshes="2f84a5ff1b24791f",
    ),
    control=ControlSpec(
        reach=0.06,  # R
        finger_reach=0.075,  # R
        finger_open=0.04,  # R
        yaw_reach=0.3,  # R
        max_yaw=math.pi / 4,  # R
        yaw_backtrack=0.05,  # D
        tolerance=1e-4,  # R
        max_ticks=100,  # R
        arm_force=500.0,  # R
        gripper_start=1.0,  # R: open
        gripper_threshold=0.5,  # D
        ik_damping=1e-3,  # D
        ik_iterations=20,  # D
        ik_residual=1e-6,  # D
        ik_projections=10,  # D
        ik_limit_margin=0.02,  # D
    ),
    observation=ObservationSpec(
        image_size=84,  # T
        grey_weights=(2989, 5870, 1140),  # R
        touch_size=11,  # T
        position_limit=2.0,  # D
        table_color=(0.85, 0.73, 0.58, 1.0),  # D
        object_color=(0.30, 0.12, 0.10, 1.0),  # D
        target_color=(0.48, 0.48, 0.48, 1.0),  # T: gray
        arm_color=(0.93, 0.93, 0.95, 1.0),  # D
        hand_color=(0.30, 0.32, 0.36, 1.0),  # D
        cabinet_color=(0.30, 0.31, 0.33, 1.0),  # D
        door_color=(0.40, 0.38, 0.36, 1.0),  # D
        handle_color=(0.92, 0.92, 0.92, 1.0),  # D
        hand_drawn_width=0.4,  # D
        shadow_light=0.75,  # D
        hand_shadow_radius=0.035,  # D
        object_shadow_radius=0.025,  # D
        least_visible_pixels=15,  # D
        max_draws=50,  # D
    ),
    shapes="975ccc9ddde05b4519a40f17a4b56ae0a3109eb5e3d9b57893312bdb06c26ea8",
    tasks=TASK_SPECS,
    suites=SUITE_SPECS,
)
"""The protocol, whose tasks every list of tasks anywhere follows."""

TASK_NAMES = tuple(task.name for task in PROTOCOL.tasks)
"""Names of the tasks as the command line writes them, in the order of every table."""

SUITE_NAMES = tuple(suite.name for suite in PROTOCOL.suites)
"""Names of the suites; the first is the default."""

GOAL_TASKS = tuple(task.name for task in PROTOCOL.tasks if task.has_goal)
"""The tasks with a goal; Playing has touch only."""

LOAD_TIMEOUT_S, ACT_TIMEOUT_S, EPISODE_TIMEOUT_S = 60.0, 5.0, 300.0
"""How long a policy may take, in s: to load and reset, for one action, for a whole episode."""

MAIN_SUITE, NOVEL_SHAPES = "table4", "novel-shapes"
"""The suites of Table 4 and of Figure 11."""


PUBLIC_SEED_BITS = 64
"""A run seed of more bits is a secret; its episodes' seeds are then too many to be tried."""


def episode_seed(suite: str, task: str, index: int, run_seed: int) -> int:
    """Return the seed of one episode: 0 to 2^32 - 1, and to 2^128 - 1 where the run's is secret.

    It does not depend on the number of episodes, the number of workers, or what ran before.
    """
    sequence = np.random.SeedSequence(
        [_number(PROTOCOL.name), _number(suite), _number(task), index, run_seed]
    )
    words = 1 if run_seed.bit_length() <= PUBLIC_SEED_BITS else 4
    return int.from_bytes(
        sequence.generate_state(words, np.uint32).astype("<u4").tobytes(), "little"
    )


def policy_seed(suite: str, task: str, index: int, run_seed: int) -> int:
    """Return the seed that a policy is given in one episode, 0 to 2^64 - 1.

    SHA-256 over what the episode's seed is made of, not over that seed: a policy that could
    compute the episode's seed from its own could build the scene and look at it.
    """
    text = json.dumps(["policy", PROTOCOL.name, suite, task, index, run_seed])
    return _number(text)


def senses_generator(episode: int) -> np.random.Generator:
    """Return the generator of noise on an episode's senses, apart from that of its scene."""
    return np.random.default_rng([_number("senses"), episode])


def suite_generator(suite: str) -> np.random.Generator:
    """Return the generator of what a suite draws once for all its runs."""
    return np.random.default_rng([_number(PROTOCOL.name), _number(suite)])


def _number(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
