"""Frozen records that every layer shares. They hold data and know no simulator.

Those of ``run.json`` are its types: ``documents`` reads and writes them, and makes the schema.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Annotated, Final, Literal

import numpy as np
from msgspec import UNSET, Meta, UnsetType
from numpy.typing import NDArray

from minitouch_bench.conditions import STANDARD, Conditions

Count = Annotated[int, Meta(ge=0)]
Sha256 = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
Sha256OrNone = Annotated[str, Meta(pattern="^([0-9a-f]{64})?$")]


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
        for field in fields(self):
            if field.name == "clipped":
                continue
            array = np.ascontiguousarray(getattr(self, field.name))
            sha.update(f"{field.name}{array.dtype.str}{array.shape}".encode())
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
    """What was measured in one episode.

    ``shape``, ``family`` and ``split`` are those of the object, "" where there is none.
    ``digest`` is the SHA-256 of the trajectory: applied actions, rewards, ticks, contacts, touch
    and the object's state at every step.
    """

    task: str
    index: Count
    seed: Count
    shape: str
    family: str
    split: str
    outcome: Outcome
    steps: Count
    episode_return: float
    touch_interaction: Count
    touch_onsets: Count
    touch_steps: Count
    touch_variance: float
    object_movement: float
    first_touch_tick: Count | None
    ticks: Count
    clipped_actions: Count
    digest: Sha256

    @property
    def success(self) -> bool:
        """Whether the episode reached its goal."""
        return self.outcome is Outcome.SUCCESS


@dataclass(frozen=True)
class Estimate:
    """A mean with its 95 % interval over ``count`` episodes; ``method`` says how."""

    value: float
    low: float
    high: float
    count: Count
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
    outcomes: Mapping[Outcome, Count]
    touch_curve: tuple[float, ...]
    touch_curve_episodes: tuple[Count, ...] = ()


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


IN_MEMORY = "in memory"
"""The kind of a policy that was given as an object."""

NOT_IN_SANDBOX = ("scripted", IN_MEMORY, "remote")
"""Kinds of policies that run outside the sandbox, whatever is asked for."""


@dataclass(frozen=True)
class PolicyIdentity:
    """What was evaluated. ``digest`` is the SHA-256 of the file's bytes, "" for a built-in.

    ``notes`` are labels every table shows, such as "remote" or "reads the simulator".
    """

    name: str
    source: str
    kind: str
    digest: Sha256OrNone
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class RunHeader:
    """Everything that fixes the numbers of a run, known before its first episode.

    ``task_digests``: the protocol's digest for each task; results of a task are comparable where
    its digests are equal. ``episode_timeout_s`` and ``conditions`` are left out where they are
    those of the protocol. ``chosen_episodes`` names those that were run, as in "pushing/17", where
    it was not every one of ``episodes`` per task.
    """

    protocol: str
    protocol_digest: str
    task_digests: Mapping[str, str]
    suite: str
    official: bool
    unofficial_because: tuple[str, ...]
    tasks: tuple[str, ...]
    episodes: Count
    seed: Count
    policy: PolicyIdentity
    exploration: PolicyIdentity | None
    act_timeout_s: float
    isolation: str
    episode_timeout_s: float | UnsetType = UNSET
    conditions: Conditions | UnsetType = UNSET
    chosen_episodes: tuple[str, ...] | UnsetType = UNSET

    @property
    def played_under(self) -> Conditions:
        """The conditions of the run's episodes."""
        return STANDARD if self.conditions is UNSET else self.conditions

    @property
    def chosen(self) -> tuple[str, ...]:
        """The chosen episodes; none where every one was run."""
        return () if self.chosen_episodes is UNSET else self.chosen_episodes

    def rules_differ(self, other: "RunHeader") -> tuple[str, ...]:
        """Return the tasks of both runs that were not played by the same rules."""
        return tuple(
            task
            for task in self.tasks
            if task in other.tasks and self.task_digests.get(task) != other.task_digests.get(task)
        )


@dataclass(frozen=True)
class RunEnvironment:
    """Where and when a run was made; never part of its numbers."""

    packages: Mapping[str, str]
    machine: Mapping[str, str]
    workers: Count
    started: str
    wall_s: float


@dataclass(frozen=True)
class EvaluationRun:
    """A finished evaluation: its header and one record an episode, in the suite's order."""

    header: RunHeader
    environment: RunEnvironment
    records: tuple[EpisodeRecord, ...]


RUN_FORMAT: Final = "minitouch-run"
RUN_VERSION: Final = 2
"""Raised whenever a field of ``run.json`` is added or means something else, here and below."""


@dataclass(frozen=True)
class RunDocument:
    """What ``run.json`` holds: everything a report is drawn from.

    ``digest`` covers every episode: runs with equal ones hold the same bits. ``faults`` says what
    the policy did wrong, by episode, such as "pushing/17" or "exploration/pushing/17"; each is a
    failed episode. Episodes stand in the suite's order. Equal runs give equal documents except for
    ``environment``, which alone holds times.
    """

    format: Literal["minitouch-run"]
    version: Literal[2]
    digest: Sha256
    header: RunHeader
    environment: RunEnvironment
    summary: Summary
    faults: Mapping[str, str]
    episodes: tuple[EpisodeMetrics, ...]
    exploration_episodes: tuple[EpisodeMetrics, ...]

    def by_role(self) -> tuple[tuple[Role, tuple[EpisodeMetrics, ...]], ...]:
        """Return the episodes of each role, the final policy's first."""
        return (Role.FINAL, self.episodes), (Role.EXPLORATION, self.exploration_episodes)


@dataclass(frozen=True)
class SavedRun(RunDocument):
    """A run as read back, and what it is called: usually by its directory's name."""

    name: str
