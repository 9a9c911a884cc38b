"""The settings of a training, as one frozen value that a TOML file can contain."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

from msgspec import Meta

from minitouch_bench.agents import METHODS
from minitouch_bench.episode import Count
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.files import MAX_EPISODES
from minitouch_bench.json_io import read_toml, take_table
from minitouch_bench.perturbation import SENSES
from minitouch_bench.protocol.minitouch import PROTOCOL

NotNegative = Annotated[int, Meta(ge=0)]
Positive = Annotated[int, Meta(ge=1)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
Factor = Annotated[float, Meta(ge=0, le=1e9)]
Entropy = Annotated[float, Meta(ge=-1e3, le=1e3)]

LEAST_REPLAY = 1000
"""Observations; the memory holds a whole episode."""

Width = Annotated[float, Meta(ge=1 / 32, le=1)]
"""Channels are scaled down from those of Table 3."""


def _check(what: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise UsageError(f"no {what} '{value}'; there are {', '.join(known)}")


@dataclass(frozen=True)
class PhaseConfig:
    """What differs between the two phases.

    ``steps``: control steps. SAC's temperature is learned, starting from
    ``initial_temperature``, so that the policy's entropy is ``target_entropy`` (nats per
    action number). Over the phase's first ``entropy_steps`` control steps the target moves
    linearly to ``final_target_entropy``; with 0 it is constant. ``n_step``: rewards summed before
    the critic's estimate, without entropy terms or a correction for older policies; exploration
    always uses 1. ``success_share``: share of each batch, at least, that led to a success.
    ``updates_per_step``: gradient steps per control step, fractions allowed.
    ``keypoint_updates``: in the task phase alone, gradient steps in which an encoder learns to find
    keypoints in the memory's images, before the first control step. A new actor and new critics,
    with layer norm, see the coordinates of these keypoints. With 0 the phase goes on with the
    networks of the exploration, which see features of the encoder of Table 3, trained by the
    critics' loss; ``fitting_updates`` and ``prior_...`` then have no effect. ``fitting_updates``:
    gradient steps that then fit the new actor to the exploration policy and the new critics to the
    memory.
    ``prior_weight``: weight of the divergence from the exploration policy, KL(policy, exploration
    policy), in the actor's loss, falling linearly to 0 within ``prior_steps`` control steps.
    ``without``: senses that actor and critics lack: ``touch``, ``forces`` or ``vision``. Each is
    constant for them (0 N, the middle of the workspace, a black picture); the curiosity has every
    sense that its method needs. Without vision no keypoints are learned.
    """

    steps: NotNegative
    learning_rate: Factor = 3e-4
    initial_temperature: Annotated[float, Meta(ge=1e-9, le=1e9)] = 0.1
    target_entropy: Entropy = -1.0
    final_target_entropy: Entropy = -1.0
    entropy_steps: NotNegative = 0
    reward_scale: Annotated[float, Meta(ge=-1e9, le=1e9)] = 1.0
    n_step: Annotated[int, Meta(ge=1, le=1000)] = 1
    success_share: Fraction = 0.0
    updates_per_step: Annotated[float, Meta(ge=0, le=1000)] = 1.0
    keypoint_updates: NotNegative = 0
    fitting_updates: NotNegative = 0
    prior_weight: Factor = 0.0
    prior_steps: NotNegative = 0
    without: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for sense in self.without:
            _check("sense", sense, SENSES)
        # In one order, so that equal settings are equal however they are written.
        object.__setattr__(self, "without", tuple(one for one in SENSES if one in self.without))

    @property
    def learns_keypoints(self) -> bool:
        """Whether keypoints are learned at the beginning."""
        return self.keypoint_updates > 0 and "vision" not in self.without

    def prior_weight_at(self, step: int) -> float:
        """Return the weight of the prior after ``step`` control steps of the phase."""
        return self.prior_weight * max(0.0, 1.0 - step / max(1, self.prior_steps))

    def target_entropy_at(self, step: int) -> float:
        """Return the target entropy after ``step`` control steps of the phase."""
        fallen = min(step / self.entropy_steps, 1.0) if self.entropy_steps else 0.0
        return self.target_entropy + fallen * (self.final_target_entropy - self.target_entropy)


@dataclass(frozen=True)
class SacConfig:
    """What the learner keeps through both phases.

    ``encoder_width`` scales the channels of the shared encoder, up to a multiple of 8.
    ``shift``: pixels by which images are shifted at random (DrQ); 0 for no shift. A policy that
    sees keypoints learns without shifts, without ``target_encoder`` and in full precision.
    ``target_rate``: share by which the target networks follow at each update.
    ``target_encoder``: the target critics have an encoder that follows as well; DrQ-v2
    has none. ``bfloat16``: encode in half precision where the processor can.
    """

    batch_size: Annotated[int, Meta(ge=1, le=65_536)] = 128
    discount: Fraction = 0.99
    encoder_width: Width = 1.0
    target_rate: Fraction = 0.01
    shift: Annotated[int, Meta(ge=0, le=PROTOCOL.observation.image_size)] = 4
    target_encoder: bool = False
    bfloat16: bool = True


@dataclass(frozen=True)
class CuriosityConfig:
    """How the intrinsic reward is computed.

    ``rnd``, ``rnd-touch`` and ``disagreement`` learn at 10/3 times ``learning_rate``. ``width``
    scales the channels of the curiosity's own encoder. ``normalize`` divides the reward by its
    standard deviation over the last 100 batches, ``hac``'s over all.
    """

    learning_rate: Factor = 3e-4
    width: Width = 0.25
    normalize: bool = True
    bfloat16: bool = True


@dataclass(frozen=True)
class TrainingConfig:
    """One training: a task, a method, a seed, and every setting; ``make_config`` checks ranges.

    ``dataset``: a recorded one, on which exploration makes its gradient steps without acting.
    ``sac`` acts, with the dataset in its replay memory.
    ``method``: one of METHODS, or a class of your own, ``package.module:Class``, whose source file
    has the SHA-256 ``method_digest``.
    ``design``: SHA-256 of the design of the study that the training is part of; it changes nothing.
    ``episode_steps``: control steps after which a training episode ends; 0: the task's.
    ``random_steps``: uniformly random actions before learning starts; none with a dataset.
    ``replay_size``: observations in the replay memory; the oldest are removed.
    ``log_every``: control steps between two rows of ``progress.csv``. After each
    ``evaluate_every`` (0: never) the policy plays ``evaluate_episodes`` episodes of its own, with
    the objects of the task, and there is a row as well. ``checkpoint_every``: control steps that a
    killed training may lose.
    """

    task: str
    method: str = "hac"
    method_digest: str = ""
    seed: Count = 0
    objects: str = ""
    dataset: str = ""
    design: str = ""
    episode_steps: Annotated[int, Meta(ge=0, lt=LEAST_REPLAY)] = 50
    random_steps: Positive = 1000
    replay_size: Annotated[int, Meta(ge=LEAST_REPLAY)] = 1_000_000
    log_every: Positive = 500
    evaluate_every: NotNegative = 5000
    evaluate_episodes: Annotated[int, Meta(ge=1, le=MAX_EPISODES)] = 10
    checkpoint_every: Positive = 1000
    exploration: PhaseConfig = PhaseConfig(10_000, target_entropy=0.0, updates_per_step=0.5)
    task_phase: PhaseConfig = PhaseConfig(
        15_000,
        target_entropy=0.0,
        final_target_entropy=-1.0,
        entropy_steps=10_000,
        n_step=3,
        success_share=0.25,
        updates_per_step=4.0,
        keypoint_updates=2000,
        fitting_updates=3000,
        prior_weight=0.1,
        prior_steps=10_000,
    )
    sac: SacConfig = SacConfig(discount=0.95, encoder_width=0.25)
    curiosity: CuriosityConfig = CuriosityConfig()

    def __post_init__(self) -> None:
        if ":" not in self.method:
            _check("method", self.method, METHODS)

    @property
    def name(self) -> str:
        """Return the usual name of its directory: TASK-METHOD[-no-SENSE]-SEED."""
        lacking = self.exploration.without
        senses = [f"no-{sense}" for sense in lacking]
        senses += [f"task-no-{one}" for one in self.task_phase.without if one not in lacking]
        return "-".join((self.task, self.method.rpartition(":")[2], *senses, str(self.seed)))

    @property
    def steps(self) -> int:
        """Return the control steps of both phases."""
        return self.exploration.steps + self.task_phase.steps

    def is_longer_than(self, other: "TrainingConfig") -> bool:
        """Tell whether this is the other training with more steps in its last phase.

        A task phase that has not begun can have other senses too.
        """
        explored, without = other.exploration.steps, other.task_phase.without
        if other.task_phase.steps == 0:
            explored = max(explored, self.exploration.steps)
            without = self.task_phase.without if other.exploration_steps else without
        longer = replace(
            other,
            exploration=replace(other.exploration, steps=explored),
            task_phase=replace(other.task_phase, steps=self.task_phase.steps, without=without),
        )
        return self == longer and self.steps > other.steps

    @property
    def without(self) -> tuple[str, ...]:
        """Return the senses that the final policy lacks."""
        explores_only = self.exploration_steps and not self.task_phase.steps
        return (self.exploration if explores_only else self.task_phase).without

    @property
    def exploration_steps(self) -> int:
        """Return the control steps without the task's reward; ``sac`` has it from the first."""
        return 0 if self.method == "sac" else self.exploration.steps

    @property
    def task_phase_begin(self) -> int:
        """Return the control steps before learning from the task's reward."""
        return self.exploration_steps or (0 if self.dataset else self.random_steps)


def paper_config(task: str) -> TrainingConfig:
    """Return the values of Tables 2 and 3 of the supplement, with our values where it has none.

    It departs from the supplement in three places. The strides of the encoder are 4, 2, 2, 2:
    the printed 4, 2, 1, 1 do not give the printed sizes, ours give all but one (9 in place of 8).
    Both phases have the one learning rate of Table 2 and a learned temperature, although 7.3 says
    that alpha and the learning rate change between them. The task phase is longer than the 5,000
    to 10,000 control steps of 7.6: see PHASE_STEPS.
    """
    phase = PhaseConfig(10_000, learning_rate=3e-5, reward_scale=100.0)
    return TrainingConfig(
        task,
        episode_steps=0,
        exploration=phase,
        task_phase=phase,
        sac=SacConfig(shift=0, target_rate=0.005, target_encoder=True),
        curiosity=CuriosityConfig(learning_rate=3e-5, width=1.0, normalize=False),
    )


PRESETS = {"default": TrainingConfig, "paper": paper_config}
"""Builders of a task's settings by the preset's name."""


PHASE_STEPS: Mapping[str, tuple[int, int]] = {
    "playing": (10_000, 0),
    "pushing": (15_000, 15_000),
    "opening": (10_000, 10_000),
    "pick-up": (30_000, 20_000),
}
"""Control steps of exploration and of the task phase in every preset: those of
experiments/touch/design.toml. Playing has no goal to learn. The supplement does not give the length
of exploration; it says that 5,000 to 10,000 steps of the task suffice for decent performance in
Pushing and Pick-up (7.6)."""


def make_config(
    task: str,
    preset: str = "default",
    file: Path | None = None,
    settings: Mapping[str, Any] = MappingProxyType({}),
) -> TrainingConfig:
    """Return a preset's settings for a task, changed by a TOML file, then by ``settings``.

    The phases have the lengths of PHASE_STEPS, or the preset's for a task that is not in it.

    A ``task`` in either changes nothing, so that a training's own ``config.toml`` serves another
    one. ``settings`` are nested as in the file: ``{"seed": 1, "task_phase": {"steps": 80_000}}``.

    Raises:
        UsageError: no such task or preset, a file that cannot be read, a setting that there is
            not, or a value of another type or outside its range.
    """
    PROTOCOL.task(task)
    _check("preset", preset, tuple(PRESETS))
    base = PRESETS[preset](task)
    explored, learned = PHASE_STEPS.get(task, (base.exploration.steps, base.task_phase.steps))
    base = replace(
        base,
        exploration=replace(base.exploration, steps=explored),
        task_phase=replace(base.task_phase, steps=learned),
    )
    if file is not None:
        base = take_table(read_toml(file), TrainingConfig, str(file), base)
    return replace(take_table(settings, TrainingConfig, base=base), task=task)


def read_recorded_config(path: Path) -> TrainingConfig:
    """Return the settings that a training has recorded in its directory, every one of them.

    Raises:
        RunDirectoryError: the file is unreadable, sets what there is not, or lacks a setting: a
            default in its place could make another training of it.
    """
    try:
        table = read_toml(path)
        config = take_table(table, TrainingConfig, str(path))
    except UsageError as error:
        raise RunDirectoryError(str(error)) from error
    if missing := _by_name(asdict(config)).keys() - _by_name(table).keys():
        names = ", ".join(sorted(missing))
        raise RunDirectoryError(f"{path} lacks {names}: restore it, or train again")
    return config


def differing_settings(recorded: TrainingConfig, asked: TrainingConfig) -> list[str]:
    """Return each setting that differs, with both values."""
    there = _by_name(asdict(recorded))
    return [
        f"{name}: {there[name]!r} there, {wanted!r} asked for"
        for name, wanted in _by_name(asdict(asked)).items()
        if wanted != there[name]
    ]


def _by_name(settings: Mapping[str, Any], table: str = "") -> dict[str, Any]:
    """Return settings of nested tables by their names, as in ``task_phase.steps``."""
    named: dict[str, Any] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping):
            named |= _by_name(value, f"{table}{name}.")
        else:
            named[f"{table}{name}"] = value
    return named
