"""Under which conditions a policy plays: changed senses, a changed world, and its limits."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Final, Literal, get_args

from msgspec import Meta

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import (
    ACT_TIMEOUT_S,
    EPISODE_TIMEOUT_S,
    LOAD_TIMEOUT_S,
    PROTOCOL,
)

if TYPE_CHECKING:
    import numpy as np

Sense = Literal["touch", "forces", "vision"]
Range = tuple[float, float]

SENSES: Final[tuple[Sense, ...]] = get_args(Sense)
"""What can be taken away: the touch vector, its finger forces alone, the picture."""


@dataclass(frozen=True)
class Perturbation:
    """What differs from the protocol in the senses and the world. A run with any is unofficial.

    A sense in ``without`` stays as it is at the reset. ``noise`` (gray levels) and
    ``force_noise`` (N) are standard deviations of normal noise on each pixel and each force.
    The others are ranges, drawn uniformly in each episode: factors on the ``mass`` and the
    ``friction`` of the object or the door, and the degrees by which the ``camera`` is turned
    around what it looks at.

    Raises:
        ValueError: a value that means nothing.
    """

    without: tuple[Sense, ...] = ()
    noise: float = 0.0
    force_noise: float = 0.0
    mass: Range = (1.0, 1.0)
    friction: Range = (1.0, 1.0)
    camera: Range = (0.0, 0.0)

    def __post_init__(self) -> None:
        if self.without != tuple(sense for sense in SENSES if sense in self.without):
            raise ValueError(f"senses are {', '.join(SENSES)}, each once and in this order")
        for name, (least, most, unit) in _ALLOWED.items():
            low, high = _as_range(getattr(self, name))
            if not least <= low <= high <= most:
                raise ValueError(f"{name} is {least:g} to {most:g} {unit}")

    @property
    def change_the_senses(self) -> bool:
        """Whether a policy is given other observations than the environment's."""
        return bool(self.without or self.noise or self.force_noise)

    def draw(self, rng: "np.random.Generator") -> tuple[float, float, float]:
        """Draw one episode's factors on mass and friction, and the degrees of its camera."""
        uniform = rng.uniform
        return uniform(*self.mass), uniform(*self.friction), uniform(*self.camera)

    def in_words(self) -> tuple[str, ...]:
        """Return what is different, for people."""
        changed = (
            f"{name} {text.replace(':', ' to ')} {_ALLOWED[name.replace('-', '_')][2]}"
            for name, text in self._changed()
        )
        return (*(f"without {sense}" for sense in self.without), *changed)

    def as_options(self) -> tuple[str, ...]:
        """Return the command line's options that ``parse_perturbation`` reads back."""
        words = ["--without", ",".join(self.without)] if self.without else []
        changes = [f"{name}={text}" for name, text in self._changed()]
        return (*words, *(["--perturb", ",".join(changes)] if changes else []))

    def _changed(self) -> Iterator[tuple[str, str]]:
        """Yield what is not as usual, as it is spelled on the command line, with its value."""
        for name in _ALLOWED:
            value = getattr(self, name)
            if value != getattr(UNPERTURBED, name):
                low, high = _as_range(value)
                yield _spelled(name), f"{low:.15g}" if low == high else f"{low:.15g}:{high:.15g}"


_ALLOWED: Mapping[str, tuple[float, float, str]] = {
    "noise": (0.0, 255.0, "gray levels"),
    "force_noise": (0.0, 1000.0, "N"),
    "mass": (0.01, 100.0, "times"),
    "friction": (0.01, 100.0, "times"),
    "camera": (-180.0, 180.0, "degrees"),
}
"""The least and the greatest value of each change, and their unit."""


def _as_range(value: float | Range) -> Range:
    return value if isinstance(value, tuple) else (value, value)


def _spelled(name: str) -> str:
    return name.replace("_", "-")


PERTURBATION_NAMES: Final = tuple(map(_spelled, _ALLOWED))
"""What can be changed, as it is spelled on the command line."""

UNPERTURBED: Final = Perturbation()
"""The protocol's own conditions."""


def parse_perturbation(without: Sequence[str], changes: Sequence[str]) -> Perturbation:
    """Read ``["touch"]`` and ``["mass=2", "camera=-5:5"]``, as on the command line.

    Raises:
        UsageError: no such sense or condition, or a value that it cannot have.
    """
    for sense in without:
        if sense not in SENSES:
            raise UsageError(f"no sense '{sense}'; there are {', '.join(SENSES)}")
    ordered = tuple(sense for sense in SENSES if sense in without)
    values: dict[str, float | Range] = {}
    for change in changes:
        spelled, _, text = change.partition("=")
        if spelled not in PERTURBATION_NAMES:
            raise UsageError(f"no condition '{spelled}'; there are {', '.join(PERTURBATION_NAMES)}")
        name = spelled.replace("-", "_")
        low, colon, high = text.partition(":")
        try:
            if isinstance(getattr(UNPERTURBED, name), tuple):
                values[name] = (float(low), float(high if colon else low))
            else:
                values[name] = float(text)
        except ValueError:
            raise UsageError(f"'{change}' is no condition; write mass=2 or mass=0.5:2") from None
    try:
        return Perturbation(without=ordered, **values)  # type: ignore[arg-type]
    except ValueError as error:
        raise UsageError(str(error)) from error


MAX_TIMEOUT_S = 86400.0
MAX_MEMORY_MB = 2**24

Seconds = Annotated[float, Meta(gt=0)]

MAX_ACTS = max(task.max_steps for task in PROTOCOL.tasks)
"""Acts in the longest episode, for the limit of processor time."""


@dataclass(frozen=True)
class PolicyLimits:
    """How long a policy may take, in s: to load and reset, for one action, for a whole episode.

    The time of an episode is all that is spent on waiting for the policy, and not the world's.
    In the sandbox its memory is limited too, in MiB beyond what the format's packages take.

    Raises:
        UsageError: a time that cannot be waited for.
    """

    load_timeout_s: Seconds = LOAD_TIMEOUT_S
    act_timeout_s: Seconds = ACT_TIMEOUT_S
    episode_timeout_s: Seconds = EPISODE_TIMEOUT_S
    memory_mb: Annotated[int, Meta(gt=0)] = 8192

    def __post_init__(self) -> None:
        for limit in (self.load_timeout_s, self.act_timeout_s, self.episode_timeout_s):
            if not 0 < limit <= MAX_TIMEOUT_S:
                raise UsageError(
                    f"a time limit is above 0 and at most {MAX_TIMEOUT_S:g} s, not {limit}"
                )
        if not 0 < self.memory_mb <= MAX_MEMORY_MB:
            raise UsageError(f"a memory limit is 1 to {MAX_MEMORY_MB} MiB, not {self.memory_mb}")

    def as_options(self) -> tuple[str, ...]:
        """Return the command line's options for the times that are not the protocol's."""
        words: list[str] = []
        if self.act_timeout_s != ACT_TIMEOUT_S:
            words += ["--act-timeout", f"{self.act_timeout_s:.15g}"]
        if self.episode_timeout_s != EPISODE_TIMEOUT_S:
            words += ["--episode-timeout", f"{self.episode_timeout_s:.15g}"]
        return tuple(words)

    def within(self, most: "PolicyLimits") -> "PolicyLimits":
        """Return these limits, each of them at most that of ``most``."""
        return PolicyLimits(
            *(min(getattr(self, one.name), getattr(most, one.name)) for one in fields(self))
        )

    @property
    def cpu_s(self) -> int:
        """Return the processor time that one thread could use within the timeouts."""
        return math.ceil(self.load_timeout_s + MAX_ACTS * self.act_timeout_s)


USUAL_LIMITS = PolicyLimits()
"""The default."""
