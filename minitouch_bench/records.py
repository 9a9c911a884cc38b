"""Frozen records that every layer shares. They hold data and know no simulator."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Outcome(StrEnum):
    """How an episode ended."""

    SUCCESS = "success"
    LEFT_WORKSPACE = "left_workspace"
    STEP_LIMIT = "step_limit"
    POLICY_FAULT = "policy_fault"


class Role(StrEnum):
    """Which checkpoint of a submission an episode evaluates."""

    FINAL = "final"
    EXPLORATION = "exploration"


@dataclass(frozen=True, order=True)
class EpisodeSpec:
    """One episode to run; it fixes everything but the policy.

    ``shape`` names the object ("" where the task has none), ``family`` and ``split`` say
    what it is in its shape set ("" for a task's own cube).
    """

    role: Role
    task: str
    index: int
    seed: int
    shape: str = ""
    family: str = ""
    split: str = ""

    @property
    def key(self) -> str:
        """Name of the episode inside its run, as ``pushing/17``."""
        prefix = "exploration/" if self.role is Role.EXPLORATION else ""
        return f"{prefix}{self.task}/{self.index}"


@dataclass(frozen=True)
class EpisodeTrace:
    """What was measured at each of the T control steps of one episode.

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

    def digest(self) -> str:
        """SHA-256 over every array and its shape: equal digests mean equal bits.

        ``clipped`` is left out: it tells what the policy asked for, not what happened, and
        whoever replays the applied actions must find the same digest.
        """
        sha = hashlib.sha256()
        for one in fields(self):
            if one.name == "clipped":
                continue
            array = np.ascontiguousarray(getattr(self, one.name))
            sha.update(f"{one.name}{array.dtype.str}{array.shape}".encode())
            sha.update(array.tobytes())
        return sha.hexdigest()


@dataclass(frozen=True)
class EpisodeRecord:
    """One finished episode. ``fault`` says what the policy did wrong, "" if nothing."""

    spec: EpisodeSpec
    outcome: Outcome
    trace: EpisodeTrace
    fault: str = ""


@dataclass(frozen=True)
class EpisodeMetrics:
    """The metrics of one episode: a row of ``episodes.csv``, in its column order.

    ``family`` and ``split`` of the shape, and ``digest``, the trajectory's, stand in
    ``run.json`` alone.

    ``touch_variance`` is in N², ``object_movement`` in m² (Opening: rad²),
    ``time_to_first_touch`` and ``arm_time`` in s; None where the finger never touched.
    """

    task: str
    index: int
    seed: int
    shape: str
    outcome: Outcome
    success: bool
    steps: int
    episode_return: float = field(metadata={"column": "return"})
    touch_interaction: int
    touch_onsets: int
    touch_steps: int
    touch_variance: float
    object_movement: float
    time_to_first_touch: float | None
    arm_time: float
    clipped_actions: int
    family: str = ""
    split: str = ""
    digest: str = ""

    @classmethod
    def columns(cls) -> dict[str, str]:
        """Return the field of each column, by the name that files give it."""
        return {one.metadata.get("column", one.name): one.name for one in fields(cls)}


@dataclass(frozen=True)
class Estimate:
    """A mean with its 95 % interval over ``count`` episodes; ``method`` says how."""

    value: float
    low: float
    high: float
    count: int
    method: str


@dataclass(frozen=True)
class TaskSummary:
    """Estimates of one task by metric name, and two descriptions of its episodes.

    ``touch_curve``: mean contact ticks at each control step, over the episodes that
    reached it; ``touch_curve_episodes``: how many did. ``outcomes``: number of episodes by
    how they ended.
    """

    task: str
    estimates: Mapping[str, Estimate]
    outcomes: Mapping[str, int]
    touch_curve: tuple[float, ...]
    touch_curve_episodes: tuple[int, ...] = ()


@dataclass(frozen=True)
class Gap:
    """A metric on the held-out and on the train shapes, and held-out minus train.

    ``difference`` counts the episodes of both.
    """

    held_out: Estimate
    train: Estimate
    difference: Estimate


@dataclass(frozen=True)
class FamilyResult:
    """A metric on one family's shapes; None for a split without an episode."""

    held_out: Estimate | None
    train: Estimate | None


@dataclass(frozen=True)
class Generalization:
    """What a task's figures are on shapes never trained on, beside those trained on.

    ``gaps`` by metric name; ``families`` by name, each estimating ``family_metric``.
    """

    task: str
    gaps: Mapping[str, Gap]
    family_metric: str
    families: Mapping[str, FamilyResult]


@dataclass(frozen=True)
class Summary:
    """The estimates of a run, task by task.

    ``generalization`` has the tasks that were run on both splits of a shape set.
    """

    tasks: tuple[TaskSummary, ...]
    generalization: tuple[Generalization, ...] = ()


@dataclass(frozen=True)
class PolicyIdentity:
    """What was evaluated. ``digest`` is the SHA-256 of the file's bytes, "" for a built-in.

    ``notes`` are labels every table shows, such as "remote" or "reads the simulator".
    """

    name: str
    source: str
    kind: str
    digest: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class RunHeader:
    """Everything that fixes the numbers of a run, known before its first episode."""

    protocol: str
    protocol_digest: str
    suite: str
    official: bool
    unofficial_because: tuple[str, ...]
    tasks: tuple[str, ...]
    episodes: int
    seed: int
    policy: PolicyIdentity
    exploration: PolicyIdentity | None
    act_timeout_s: float
    isolation: str


@dataclass(frozen=True)
class RunEnvironment:
    """Where and when a run was made; never part of its numbers."""

    packages: Mapping[str, str]
    machine: Mapping[str, str]
    workers: int
    started: str
    wall_s: float


@dataclass(frozen=True)
class EvaluationRun:
    """A finished evaluation: its header and one record an episode, in the suite's order."""

    header: RunHeader
    environment: RunEnvironment
    records: tuple[EpisodeRecord, ...]


@dataclass(frozen=True)
class SavedRun:
    """A run as read back from its directory: what every report starts from.

    ``digest`` covers every episode: runs with equal ones hold equal bits.
    """

    name: str
    digest: str
    header: RunHeader
    environment: RunEnvironment
    summary: Summary
    episodes: tuple[EpisodeMetrics, ...]
    exploration_episodes: tuple[EpisodeMetrics, ...]
    faults: Mapping[str, str]
    document: Mapping[str, Any]
