"""The types of the protocol: everything that fixes an episode, as frozen values; valid actions.

Values that tasks share are their defaults; ``protocol.minitouch`` has those of each task and suite,
and says what the letters T, R and D mean. Simulation and tasks receive them; no other file contains
a number of the protocol.

A digest is taken over a value's document, whose keys are the fields' names, or ``metadata["key"]``
where a field was renamed: names in code may change without changing a digest. A tuple can have one
key for each of its items. A field that was added later is in the document where it differs from
``metadata["frozen"]``, which earlier code implied.
``undigested`` marks fields that no episode depends on.
"""

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.errors import InvalidActionError, UsageError
from minitouch_bench.text import describe

Rgba = tuple[float, float, float, float]

CUBE = "cube"
"""What ``default_objects`` calls a task's own cube."""


class Split(StrEnum):
    """The two parts of a shape set: the shapes that may be trained on, and the others."""

    TRAIN = "train"
    HELD_OUT = "held-out"


UNDIGESTED: Mapping[str, Any] = {"undigested": True}


@dataclass(frozen=True)
class Workspace:
    """The box in which the end effector moves (m)."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def holds(self, x: float, y: float) -> bool:
        """Tell whether a position on the table lies inside, looking from above."""
        return self.low[0] <= x <= self.high[0] and self.low[1] <= y <= self.high[1]


@dataclass(frozen=True)
class CameraSpec:
    """Where a camera stands: looking at ``target`` (m) from ``distance`` (m), angles in degrees."""

    target: tuple[float, float, float]
    yaw: float
    pitch: float
    near: float
    distance: float = 0.7
    field_of_view: float = 60.0
    far: float = 10.0


@dataclass(frozen=True)
class PhysicsSpec:
    """The simulated world that all tasks share; SI units."""

    simulator: str = "pybullet 3.2.7"  # D
    tick_rate: int = 240  # R
    gravity: float = -9.8  # R
    table_top: float = -0.025  # R
    table_center: tuple[float, float] = (0.5, 0.0)  # R
    table_half_extents: tuple[float, float, float] = (1.0, 1.0, 0.05)  # D
    table_friction: float = 1.0  # R
    finger_stiffness: float = 300_000.0  # R
    finger_damping: float = 1_000.0  # R
    arm_meshes: str = "2f84a5ff1b24791f"
    """Digest of the arm's mesh files."""


@dataclass(frozen=True)
class ControlSpec:
    """How one control step moves the arm; m, rad, N, N·m."""

    reach: float = 0.06  # R
    """Offset of the end effector per unit of action."""
    finger_reach: float = 0.075  # R
    """Change of each finger's target per unit of action."""
    finger_open: float = 0.04  # R
    """Upper end of a finger joint."""
    yaw_reach: float = 0.3  # R
    """Change of the gripper's yaw per unit of action."""
    max_yaw: float = math.pi / 4  # R
    yaw_backtrack: float = 0.05  # D
    """Step in which the yaw is lowered where the wrist meets its limits."""
    tolerance: float = 1e-4  # R
    """A control step ends when the end effector is this close to its target."""
    max_ticks: int = 100  # R
    """A control step ends after this many ticks in any case."""
    arm_force: float = 500.0  # R
    gripper_start: float = 1.0  # R: open
    """Where the inner opening of a discrete gripper starts, 0 to 1."""
    gripper_threshold: float = 0.5  # D
    """A discrete gripper closes below this opening, else it opens."""
    ik_damping: float = 1e-3  # D
    ik_iterations: int = 20  # D
    ik_residual: float = 1e-6  # D
    ik_projections: int = 10  # D
    """How often a solution beyond the joints' limits is moved inside and solved again."""
    ik_limit_margin: float = 0.02  # D
    """How far inside its limit a joint is moved then."""


@dataclass(frozen=True)
class ObservationSpec:
    """What a policy sees and feels."""

    image_size: int = 84  # T
    """Width and height in pixels."""
    grey_weights: tuple[int, ...] = (2989, 5870, 1140)  # R
    """Ten-thousandths of red, green and blue."""
    touch_size: int = 11  # T
    position_limit: float = 2.0  # D
    """Bound of the end effector's position (m)."""
    table_color: Rgba = (0.85, 0.73, 0.58, 1.0)  # D
    object_color: Rgba = (0.30, 0.12, 0.10, 1.0)  # D
    target_color: Rgba = (0.48, 0.48, 0.48, 1.0)  # T: gray
    arm_color: Rgba = (0.93, 0.93, 0.95, 1.0)  # D
    hand_color: Rgba = (0.30, 0.32, 0.36, 1.0)  # D
    cabinet_color: Rgba = (0.30, 0.31, 0.33, 1.0)  # D
    door_color: Rgba = (0.40, 0.38, 0.36, 1.0)  # D
    handle_color: Rgba = (0.92, 0.92, 0.92, 1.0)  # D
    hand_drawn_width: float = 0.4  # D
    """Share of the hand's width that is drawn: whole, it would hide the fingers."""
    shadow_light: float = 0.75  # D
    """Share of the light that is left in a shadow."""
    hand_shadow_radius: float = 0.035  # D
    object_shadow_radius: float = 0.025  # D
    least_visible_pixels: int = 15  # D
    """What a task needs shows at least this many pixels when an episode begins."""
    max_draws: int = 50  # D
    """How often a scene that hides it is drawn, at most."""

    position = slice(0, 3)
    """Where the touch vector has the end-effector position (m)."""
    openings = slice(3, 5)
    """Where it has the finger openings, left and right, 0 (closed) to 1 (0.04 m)."""
    forces = slice(5, 11)
    """Where it has the force at the finger joints (N): left x, y, z, then right x, y, z."""

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """Channels, height and width of an image."""
        return 1, self.image_size, self.image_size


@dataclass(frozen=True)
class ArmSpec:
    """How a task holds the Panda.

    ``start_joints``: seven arm joints (rad) and two fingers (m). ``posture``: the seven arm
    joints (rad) that inverse kinematics starts from. ``motor_force``: of the left and the right
    finger (N).
    """

    start_joints: tuple[float, ...]
    posture: tuple[float, ...]
    faces_door: bool = False
    motor_force: tuple[float, float] = field(
        default=(25.0, 20.0), metadata={"key": "finger_forces"}
    )
    discrete_gripper: bool = False


@dataclass(frozen=True, kw_only=True)
class TaskSpec:
    """The facts of a task that are not its scene's own.

    ``revision`` is raised when code changes an episode without changing a value.
    ``goal`` says in words what success is; "" where the task has none. ``portrait`` is the view
    for people. ``force_limit`` (N) bounds the touch vector's forces. ``movement_unit``: what
    ``object_movement`` is measured in. ``default_objects``: "cube", a split of the shape set,
    or "" where there is no object to choose.
    """

    name: str
    revision: int
    title: str = field(metadata=UNDIGESTED)
    goal: str = field(metadata=UNDIGESTED)
    portrait: CameraSpec = field(metadata=UNDIGESTED)
    movement_unit: str = field(default="m²", metadata=UNDIGESTED)
    workspace: Workspace
    camera: CameraSpec
    arm: ArmSpec
    force_limit: float = 50.0
    default_objects: str = CUBE
    object_can_leave: bool = False
    """Whether an episode ends when the object leaves the workspace in x, y."""
    shadows: bool = True
    max_steps: int = 200
    success_reward: float = 25.0

    @property
    def gym_id(self) -> str:
        """The Gymnasium id, as ``MiniTouch/PickUp-v1`` for "pick-up"."""
        return f"MiniTouch/{self.name.title().replace('-', '')}-v1"

    @property
    def action_size(self) -> int:
        """How many numbers an action of the task has: see ``ACTION_SIZES``."""
        return 5 if self.arm.faces_door else 4

    @property
    def has_goal(self) -> bool:
        """Whether an episode can succeed."""
        return bool(self.goal)


@dataclass(frozen=True)
class SuiteSpec:
    """A fixed set of episodes; ``rankable`` runs may enter a leaderboard."""

    name: str
    tasks: tuple[str, ...]
    episodes_per_task: int
    rankable: bool
    novel_shapes: bool = False
    """Held-out shapes beside train shapes, in place of each task's own objects."""
    seed: int = 0
    light: float = field(default=1.0, metadata={"frozen": 1.0})
    """Factor on the gray levels of every picture that a policy gets; part of its tasks' digests."""
    lacks: str = field(default="", metadata=UNDIGESTED)
    """Why a task is not in it."""


Named = TypeVar("Named", TaskSpec, SuiteSpec)


@dataclass(frozen=True)
class ProtocolSpec:
    """The whole protocol.

    ``seeds`` is raised when ``episode_seed`` or ``policy_seed`` gives other numbers. ``shapes`` is
    the digest of the canonical shape set.
    """

    name: str
    seeds: int
    physics: PhysicsSpec
    control: ControlSpec
    observation: ObservationSpec
    shapes: str
    tasks: tuple[TaskSpec, ...]
    suites: tuple[SuiteSpec, ...]

    def task(self, name: str) -> TaskSpec:
        """Return the task called ``name``.

        Raises:
            UsageError: there is none.
        """
        return _named(name, "task", self.tasks)

    def suite(self, name: str) -> SuiteSpec:
        """Return the suite called ``name``.

        Raises:
            UsageError: there is none.
        """
        return _named(name, "suite", self.suites)

    @cache  # noqa: B019  a protocol is a value that lives as long as the program
    def task_digest(self, name: str, suite: str) -> str:
        """Return the SHA-256 over all that an episode of a task in a suite depends on."""
        task, made_of = self.task(name), self.suite(suite)
        own_object = task.default_objects in ("", CUBE) and not made_of.novel_shapes
        parts = ("seeds", "physics", "control", "observation")
        shared = {part: document(getattr(self, part)) for part in parts}
        own = {"task": document(task), "shapes": "" if own_object else self.shapes}
        if made_of.light != 1.0:
            own["light"] = made_of.light
        return content_digest({"protocol": self.name, **shared, **own})

    @cache  # noqa: B019
    def digest(self) -> str:
        """Return the SHA-256 over the suites and the digests of their tasks."""
        suites = []
        for suite in self.suites:
            tasks = [self.task_digest(task, suite.name) for task in suite.tasks]
            suites.append({"suite": document(suite), "tasks": tasks})
        return content_digest(suites)


def _named(name: str, kind: str, known: Sequence[Named]) -> Named:
    for value in known:
        if value.name == name:
            return value
    names = ", ".join(value.name for value in known)
    raise UsageError(f"no {kind} '{name}'; the {kind}s are {names}")


def document(value: Any) -> Any:
    """Return a value as JSON holds it, without the undigested fields."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        found: dict[str, Any] = {}
        for f in dataclasses.fields(value):
            key, item = f.metadata.get("key", f.name), getattr(value, f.name)
            if f.metadata.get("undigested") or f.metadata.get("frozen") == item:
                continue
            keys, items = (key, item) if isinstance(key, tuple) else ((key,), (item,))
            found.update(zip(keys, map(document, items), strict=True))
        return found
    if isinstance(value, tuple | list):
        return [document(item) for item in value]
    return value


def content_digest(content: Any) -> str:
    """Return the SHA-256 of what JSON can hold, whatever the order of its keys."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


ACTION_SIZES = (4, 5)
"""Numbers in an action: dx, dy, dz, finger, and where the gripper can turn a fifth, the yaw."""


def fit_action(raw: object, size: int) -> NDArray[np.float32]:
    """Return an action as float32 (size,), unclipped.

    A leading batch axis of 1 is dropped. One agent can serve every task: where ``size`` is 4,
    the first 4 of 5 numbers are taken; where it is 5, the fifth is 0 if 4 are given.

    Raises:
        InvalidActionError: no floating-point vector of such a length, or not finite.
    """
    try:
        action = np.asarray(raw)
    except Exception as error:
        what = "not an array of numbers"
        if type(raw) is tuple:  # as Stable-Baselines3's predict returns
            what = "in a tuple: return the action alone"
        elif "requires grad" in describe(error):
            what = "a tensor that requires grad: use torch.no_grad() or .detach()"
        raise InvalidActionError(f"the action is {what}") from error
    if action.dtype.kind != "f":
        raise InvalidActionError(f"the action is of type {action.dtype}, not floats")
    if action.ndim == 2 and action.shape[0] == 1:
        action = action[0]
    if action.ndim != 1:
        raise InvalidActionError(f"the action has shape {action.shape}, not ({size},)")
    if len(action) not in ACTION_SIZES:
        known = " or ".join(map(str, ACTION_SIZES))
        raise InvalidActionError(f"the action has {len(action)} numbers, not {known}")
    with np.errstate(over="ignore"):  # a float64 too large becomes infinite, and is refused below
        single = action.astype(np.float32)
    if not np.isfinite(single).all():
        raise InvalidActionError("the action contains NaN or infinity")
    return np.append(single, np.float32(0.0))[:size]
