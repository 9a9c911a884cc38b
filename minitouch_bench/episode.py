"""Episodes as planned, played, filmed and measured; and which policy they evaluate."""

import hashlib
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from minitouch_bench.json_io import whole
from minitouch_bench.protocol.minitouch import PROTOCOL

Observation = dict[str, NDArray[Any]]
"""``image``: uint8 (C, H, W); ``touch``: float32 (11,), see ``read_touch``."""
Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Seed = Annotated[int, Meta(ge=0)]
"""Of episodes and runs; fresh episodes have 256 bits."""
Sha256 = Annotated[str, Meta(pattern=whole("[0-9a-f]{64}"))]
Sha256OrNone = Annotated[str, Meta(pattern=whole("(?:[0-9a-f]{64})?"))]


class Outcome(StrEnum):
    """How an episode ended; it is shown as its word."""

    SUCCESS = "success"
    LEFT_WORKSPACE = "left_workspace"
    STEP_LIMIT = "step_limit"
    POLICY_FAULT = "policy_fault"

    def __repr__(self) -> str:
        return repr(self.value)


class Role(StrEnum):
    """Which checkpoint of a submission an episode evaluates."""

    FINAL = "final"
    EXPLORATION = "exploration"


def episode_key(role: Role, task: str, index: int) -> str:
    """Name an episode inside its run, as ``pushing/17`` or ``exploration/pushing/17``."""
    return f"{task}/{index}" if role is Role.FINAL else f"{role}/{task}/{index}"


def role_of(key: str) -> Role:
    """Return the role that an episode's key names."""
    is_exploration = key.startswith(f"{Role.EXPLORATION}/")
    return Role.EXPLORATION if is_exploration else Role.FINAL


def task_of(key: str) -> str:
    """Return the task that an episode's key names."""
    return key.split("/")[-2]


@dataclass(frozen=True)
class EpisodeSpec:
    """An episode before it is played, and so without an outcome: all that fixes it but the policy.

    ``seed`` makes the scene; ``policy_seed`` is what the policy is given, and does not tell it.
    ``shape`` names the object ("" where the task has none), ``family`` and ``split`` say
    what it is in its shape set ("" for a task's own cube).
    """

    role: Role
    task: str
    index: int
    seed: int
    policy_seed: int = 0
    shape: str = ""
    family: str = ""
    split: str = ""

    @property
    def key(self) -> str:
        """Name of the episode inside its run, as ``pushing/17``."""
        return episode_key(self.role, self.task, self.index)


@dataclass(frozen=True)
class Start:
    """Where an episode begins: objects have settled, nothing has acted yet.

    ``position``: x, y, z of the object's center of mass (m); of the cabinet x of its front, y of
    its middle, z of its floor. ``yaw``: how the object was turned when it was drawn (rad), 0 for a
    cube and the cabinet. ``target``: x, y where Pushing's object is to go (m). ``end_effector``:
    x, y, z (m).
    """

    position: tuple[float, float, float]
    yaw: float
    target: tuple[float, float] | None
    end_effector: tuple[float, float, float]


@dataclass(frozen=True)
class Trace:
    """What happened at each of the T control steps; ``run.json`` keeps its digest alone.

    It is the world's, whatever a run's conditions give the policy in place of ``touch``.

    ``actions`` float32 (T, A), as applied (clipped); ``clipped`` bool (T,); ``rewards``
    float32 (T,); ``ticks``, ``contact_ticks``, ``onsets`` int16 (T,); ``touch`` float32
    (T + 1, 11), the first row from the reset; ``object_state`` float64 (T + 1, 3), the
    object's position in m, or (T + 1, 1), the door's angle in rad.
    ``first_touch_tick`` is the tick of the first contact, -1 if there was none.
    """

    actions: NDArray[np.float32]
    clipped: NDArray[np.bool_]
    rewards: NDArray[np.float32]
    ticks: NDArray[np.int16]
    contact_ticks: NDArray[np.int16]
    onsets: NDArray[np.int16]
    touch: NDArray[np.float32]
    object_state: NDArray[np.float64]
    first_touch_tick: int = -1

    def finger_force(self) -> NDArray[np.float32]:
        """Return the larger of both fingers' forces after each control step, float32 (T,) in N."""
        forces = self.touch[1:, PROTOCOL.observation.forces].reshape(-1, 2, 3)
        larger: NDArray[np.float32] = np.linalg.norm(forces, axis=2).max(axis=1)
        return larger

    def digest(self) -> str:
        """SHA-256 over every array and its shape: equal digests mean equal bits.

        ``clipped`` is left out: it tells what the policy asked for, not what happened, and
        whoever replays the applied actions must find the same digest.
        """
        sha = hashlib.sha256()
        for field in fields(self):
            if field.name == "clipped":
                continue
            array = np.ascontiguousarray(getattr(self, field.name))
            sha.update(f"{field.name}{array.dtype.str}{array.shape}".encode())
            sha.update(array.tobytes())
        return sha.hexdigest()


@dataclass(frozen=True)
class PlayedEpisode:
    """An episode with its start and trace, which ``measure`` turns into an ``Episode``.

    ``fault`` says what the policy did wrong, "" if nothing.

    ``is_late``: the fault is that the policy gave no answer in time, as on a slower machine.
    """

    spec: EpisodeSpec
    outcome: Outcome
    start: Start
    trace: Trace
    fault: str = ""
    is_late: bool = False


@dataclass(frozen=True)
class Film:
    """A played episode with its pictures.

    ``scenes`` uint8 (T + 1, H, W, 3): the scene at the reset and after each control step.
    ``images`` uint8 (T, 84, 84) and ``touch`` float32 (T, 11): what the policy was given before
    each of its actions; one more where it failed at the next.
    """

    played: PlayedEpisode
    scenes: NDArray[np.uint8]
    images: NDArray[np.uint8]
    touch: NDArray[np.float32]


@dataclass(frozen=True)
class Episode:
    """What was measured in one episode: a row of ``run.json``.

    ``shape``, ``family`` and ``split`` are those of the object, "" where there is none.
    ``digest`` is the SHA-256 of the trajectory: applied actions, rewards, ticks, contacts, touch
    and the object's state at every step.
    """

    task: str
    index: Count
    seed: Seed
    shape: str
    family: str
    split: str
    outcome: Outcome
    start: Start
    steps: Count
    episode_return: float
    touch_interaction: Count
    touch_onsets: Count
    touch_steps: Count
    touch_variance: float
    peak_force: float | None
    contact_force: float | None
    object_movement: float
    first_touch_tick: Count | None
    ticks: Count
    clipped_actions: Count
    digest: Sha256

    @property
    def success(self) -> bool:
        """Whether the episode reached its goal."""
        return self.outcome is Outcome.SUCCESS


IN_MEMORY = "in memory"
"""The kind of a policy that was given as an object."""


@dataclass(frozen=True)
class PolicyIdentity:
    """What was evaluated. ``digest``: SHA-256 of a file's bytes or of an object in memory, or "".

    ``notes`` are labels every table shows, such as "remote" or "reads the simulator".
    """

    name: str
    source: str
    kind: str
    digest: Sha256OrNone
    notes: tuple[str, ...] = ()

    @property
    def is_code_known(self) -> bool:
        """Whether a digest or this package tells what runs: not so of a server and a factory."""
        return self.kind not in ("remote", "factory")
