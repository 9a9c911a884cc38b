"""The protocol ``minitouch-v1``: tasks and suites, one frozen value; seeds.

Letters: T text of the paper, R the released package, D ours; ``docs/reference/protocol.md`` gives
the fact behind every R and the reason of every D. A change here changes episodes: then
``python -m benchmarks.golden`` records the golden ones again.
"""

import hashlib
import json
import math
from dataclasses import dataclass, field, replace

import numpy as np

from minitouch_bench.protocol.spec import (
    ArmSpec,
    CameraSpec,
    ControlSpec,
    ObservationSpec,
    PhysicsSpec,
    ProtocolSpec,
    Split,
    SuiteSpec,
    TaskSpec,
    Workspace,
)

POINTING_DOWN = ArmSpec(
    start_joints=(-0.028, 0.853, -0.016, -1.547, 0.017, 2.4, 2.305, 0.0, 0.0),  # R
    posture=(0.03, 1.06, 0.23, -1.89, 0.52, 2.64, 2.21),  # D
)
FACING_DOOR = ArmSpec(
    start_joints=(-0.747, 1.465, 0.968, -2.182, 2.856, 1.649, -0.220, 0.0, 0.0),  # R, moved: D
    posture=(-1.5, 1.296, 1.603, -1.97, 2.059, 2.732, -0.031),  # D
    faces_door=True,
    discrete_gripper=True,
)
TABLETOP_PORTRAIT = CameraSpec(
    (0.55, 0.0, 0.12), yaw=56.0, pitch=-24.0, near=0.05, distance=0.92, field_of_view=45.0
)


def _overhead(x: float, y: float) -> CameraSpec:
    """Return the policy's camera of the tabletop tasks (R)."""
    return CameraSpec((x, y, -0.2), yaw=90.0, pitch=-60.0, near=0.26)


@dataclass(frozen=True)
class CubeSpec:
    """A cube: side (m), mass (kg), lateral friction; it has a friction anchor."""

    side: float
    mass: float
    friction: float = 1.0


@dataclass(frozen=True, kw_only=True)
class TabletopSpec(TaskSpec):
    """A task with one object that lies on the table.

    ``margin``: least distance of the object from the workspace's sides (m). ``clearance``:
    least distance from the end effector's start (m), so that no episode begins in contact.
    ``settle_ticks``: what a shape is given to come to rest.
    """

    cube: CubeSpec
    margin: float = 0.05
    clearance: float = 0.07
    settle_ticks: int = 30


@dataclass(frozen=True, kw_only=True)
class PushingSpec(TabletopSpec):
    """Pushing: the polar draws of cube and end effector, and success; m."""

    target_margin: float = 0.025  # D: half the cube
    cube_distance: tuple[float, float] = field(
        default=(0.10, 0.20), metadata={"key": ("nearest", "furthest")}
    )
    """Least and greatest distance of the cube from its target."""
    hand_distance: tuple[float, float] = field(
        default=(0.10, 0.20), metadata={"frozen": (0.10, 0.20)}
    )
    """Least and greatest distance of the end effector's start from the cube."""
    push_clearance: float = field(default=0.07, metadata={"key": "behind"})
    """The position this far behind the object, seen from the target, is in the workspace."""
    start_height: float = 0.02  # D
    success_distance: float = 0.07  # T


@dataclass(frozen=True)
class CabinetSpec:
    """A cabinet with one hinged door, in meters, kilograms, newton meters and radians.

    Its front (the door's outer face) is the plane x = 0 of its frame, facing the robot at
    negative x; its floor is z = 0 and its middle y = 0. The half beside the door is open. The
    hinge's axis lies ``door_overhang`` inside the door's edge, the bar's middle
    ``handle_radius`` from the axis. The door is link 0, its bar link 1.
    """

    depth: float = 0.37
    width: float = 1.01
    height: float = 0.88
    wall: float = 0.02
    door_width: float = 0.497
    door_height: float = 0.835
    door_thickness: float = 0.021
    door_mass: float = 2.64
    hinge_y: float = -0.49
    hinge_friction: float = 0.496
    max_angle: float = 1.57
    door_overhang: float = 0.007
    handle_radius: float = 0.455
    handle_thickness: float = 0.026
    handle_low: float = 0.03
    handle_high: float = 0.85


@dataclass(frozen=True, kw_only=True)
class OpeningSpec(TaskSpec):
    """Opening: the cabinet, the ranges of its front's x and its middle's y (m), and success."""

    cabinet: CabinetSpec = CabinetSpec()
    front: tuple[float, float] = (0.70, 0.705)  # D
    middle: tuple[float, float] = (-0.08, 0.14)  # D
    success_angle: float = math.radians(30.0)  # T


@dataclass(frozen=True, kw_only=True)
class PickUpSpec(TabletopSpec):
    """Pick-up: ``lift`` is the height over the table of the object's lowest point (m)."""

    lift: float = 0.05  # T


PLAYING = TabletopSpec(
    name="playing",
    revision=1,
    title="Playing",
    goal="",
    portrait=TABLETOP_PORTRAIT,
    workspace=Workspace((0.5, -0.20, 0.0), (0.75, 0.25, 0.10)),  # R
    camera=_overhead(0.625, 0.025),
    arm=POINTING_DOWN,
    cube=CubeSpec(side=0.055, mass=50.0),  # R
)

PUSHING = PushingSpec(
    name="pushing",
    revision=1,
    title="Pushing",
    goal="object nearer than 7 cm to the target",
    portrait=TABLETOP_PORTRAIT,
    workspace=Workspace((0.25, -0.20, 0.0), (0.70, 0.25, 0.035)),  # T: "can be reached"
    camera=_overhead(0.475, 0.025),
    arm=POINTING_DOWN,
    object_can_leave=True,  # T
    cube=CubeSpec(side=0.05, mass=50.0),  # R
)

OPENING = OpeningSpec(
    name="opening",
    revision=1,
    title="Opening",
    goal="door open by 30 degrees",
    portrait=CameraSpec(
        (0.55, -0.05, 0.26), yaw=-62.0, pitch=-24.0, near=0.05, distance=1.45, field_of_view=45.0
    ),
    movement_unit="rad²",
    workspace=Workspace((0.5, -0.20, 0.10), (0.75, 0.20, 0.15)),  # R
    camera=CameraSpec((0.625, 0.0, 0.05), yaw=0.0, pitch=-90.0, near=0.01),  # R
    arm=FACING_DOOR,
    default_objects="",
    shadows=False,  # the camera stands where the light does
)

PICK_UP = PickUpSpec(
    name="pick-up",
    revision=1,
    title="Pick-up",
    goal="object 5 cm above the table",
    portrait=TABLETOP_PORTRAIT,
    workspace=Workspace((0.5, -0.20, 0.0), (0.75, 0.20, 0.15)),  # R
    camera=_overhead(0.625, 0.0),
    arm=replace(POINTING_DOWN, motor_force=(60.0, 60.0), discrete_gripper=True),  # D
    force_limit=200.0,  # R
    default_objects=Split.TRAIN.value,
    object_can_leave=True,  # T
    clearance=0.09,  # D: the shapes are wide, and the fingers open at the first step
    cube=CubeSpec(side=0.045, mass=0.2),  # D
)

PROTOCOL = ProtocolSpec(
    name="minitouch-v1",
    seeds=2,
    physics=PhysicsSpec(),
    control=ControlSpec(),
    observation=ObservationSpec(),
    shapes="975ccc9ddde05b4519a40f17a4b56ae0a3109eb5e3d9b57893312bdb06c26ea8",
    tasks=(PLAYING, PUSHING, OPENING, PICK_UP),
    suites=(
        SuiteSpec("table4", ("playing", "pushing", "opening", "pick-up"), 100, rankable=True),
        SuiteSpec(
            "novel-shapes", ("playing", "pushing", "pick-up"), 400, rankable=True, novel_shapes=True
        ),
        SuiteSpec(
            "dark",
            ("playing", "opening", "pick-up"),
            100,
            rankable=True,
            light=0.0,
            lacks="the light is off, and the target of pushing cannot be felt",
        ),
        SuiteSpec("smoke", ("playing", "pushing", "opening", "pick-up"), 5, rankable=False),
    ),
)
"""The protocol, whose tasks every list of tasks anywhere follows."""

TASK_NAMES = tuple(task.name for task in PROTOCOL.tasks)
"""Names of the tasks as the command line writes them, in the order of every table."""

SUITE_NAMES = tuple(suite.name for suite in PROTOCOL.suites)
"""Names of the suites; the first is the default."""

GOAL_TASKS = tuple(task.name for task in PROTOCOL.tasks if task.has_goal)
"""The tasks with a goal; Playing has touch only."""

MAIN_SUITE, NOVEL_SHAPES, DARK = "table4", "novel-shapes", "dark"
"""The suites of Table 4 and of Figure 11, and the one without light."""

PUBLIC_SEED_BITS = 64
"""A run seed of more bits is a secret; its episodes' seeds are then too many to be tried."""


# An episode's seed is a function of what the episode is, and of nothing else.


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
