"""The tasks and the suites as values. Letters: T text of the paper, R the released package, D ours.

``docs/reference/protocol.md`` gives the reason of every D. A change here changes episodes: then
``python -m minitouch_bench.verification.golden`` records the golden ones again.
"""

import math
from dataclasses import dataclass, field

from minitouch_bench.protocol.spec import ArmSpec, CameraSpec, Split, SuiteSpec, TaskSpec, Workspace

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

    target_margin: float
    cube_distance: tuple[float, float] = field(metadata={"key": ("nearest", "furthest")})
    """Least and greatest distance of the cube from its target."""
    hand_distance: tuple[float, float] = field(metadata={"frozen": (0.10, 0.20)})
    """Least and greatest distance of the end effector's start from the cube."""
    push_clearance: float = field(metadata={"key": "behind"})
    """The position this far behind the object, seen from the target, is in the workspace."""
    start_height: float
    success_distance: float


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

    cabinet: CabinetSpec
    front: tuple[float, float]
    middle: tuple[float, float]
    success_angle: float


@dataclass(frozen=True, kw_only=True)
class PickUpSpec(TabletopSpec):
    """Pick-up: ``lift`` is the height over the table of the object's lowest point (m)."""

    lift: float


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
    target_margin=0.025,  # D: half the cube
    cube_distance=(0.10, 0.20),  # T
    hand_distance=(0.10, 0.20),  # T: "in the same way"
    push_clearance=0.07,  # D
    start_height=0.02,  # D
    success_distance=0.07,  # T
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
    cabinet=CabinetSpec(),
    front=(0.70, 0.705),  # D
    middle=(-0.08, 0.14),  # D
    success_angle=math.radians(30.0),  # T
)

PICK_UP = PickUpSpec(
    name="pick-up",
    revision=1,
    title="Pick-up",
    goal="object 5 cm above the table",
    portrait=TABLETOP_PORTRAIT,
    workspace=Workspace((0.5, -0.20, 0.0), (0.75, 0.20, 0.15)),  # R
    camera=_overhead(0.625, 0.0),
    arm=ArmSpec(
        start_joints=POINTING_DOWN.start_joints,
        posture=POINTING_DOWN.posture,
        finger_forces=(60.0, 60.0),  # D
        discrete_gripper=True,
    ),
    force_limit=200.0,  # R
    default_objects=Split.TRAIN.value,
    object_can_leave=True,  # T
    clearance=0.09,  # D: the shapes are wide, and the fingers open at the first step
    cube=CubeSpec(side=0.045, mass=0.2),  # D
    lift=0.05,  # T
)

TASK_SPECS: tuple[TaskSpec, ...] = (PLAYING, PUSHING, OPENING, PICK_UP)
"""Every task, in the order of every table."""

SUITE_SPECS = (
    SuiteSpec("table4", ("playing", "pushing", "opening", "pick-up"), 100, rankable=True),
    SuiteSpec(
        "novel-shapes", ("playing", "pushing", "pick-up"), 400, rankable=True, novel_shapes=True
    ),
    SuiteSpec("smoke", ("playing", "pushing", "opening", "pick-up"), 5, rankable=False),
)
"""Every suite; the first is the default."""
