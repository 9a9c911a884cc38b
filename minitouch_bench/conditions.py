"""What an evaluation can change in a policy's senses and in the world, to see what it needs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal, get_args

from minitouch_bench.errors import UsageError

if TYPE_CHECKING:
    import numpy as np

Sense = Literal["touch", "forces", "vision"]
Range = tuple[float, float]

SENSES: Final[tuple[Sense, ...]] = get_args(Sense)
"""What can be taken away: the touch vector, its finger forces alone, the picture."""


@dataclass(frozen=True)
class Conditions:
    """Other conditions than the protocol's. A run under any is unofficial.

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
        for name, allowed in PERTURBATIONS.items():
            low, high = _as_range(getattr(self, name))
            if not allowed.low <= low <= high <= allowed.high:
                raise ValueError(f"{name} is {allowed.low:g} to {allowed.high:g} {allowed.unit}")

    @property
    def change_the_senses(self) -> bool:
        """Whether a policy is given other observations than the environment's."""
        return bool(self.without or self.noise or self.force_noise)

    def draw(self, rng: "np.random.Generator") -> tuple[float, float, float]:
        """Draw one episode's factors on mass and friction, and the degrees of its camera."""
        mass, friction, camera = (
            float(rng.uniform(*each)) for each in (self.mass, self.friction, self.camera)
        )
        return mass, friction, camera

    def in_words(self) -> tuple[str, ...]:
        """Return what is different, for people."""
        changed = (
            f"{name} {text.replace(':', ' to ')} {PERTURBATIONS[name.replace('-', '_')].unit}"
            for name, text in self._changed()
        )
        return (*(f"without {sense}" for sense in self.without), *changed)

    def as_options(self) -> tuple[str, ...]:
        """Return the command line's options that ``parse_conditions`` reads back."""
        words = ["--without", ",".join(self.without)] if self.without else []
        changes = [f"{name}={text}" for name, text in self._changed()]
        return (*words, *(["--perturb", ",".join(changes)] if changes else []))

    def _changed(self) -> Iterator[tuple[str, str]]:
        """Yield what is not as usual, as it is spelled on the command line, with its value."""
        for name in PERTURBATIONS:
            value = getattr(self, name)
            if value != getattr(STANDARD, name):
                low, high = _as_range(value)
                yield _spelled(name), f"{low:.15g}" if low == high else f"{low:.15g}:{high:.15g}"


@dataclass(frozen=True)
class Perturbation:
    """The values that a condition may have, and their unit."""

    low: float
    high: float
    unit: str


PERTURBATIONS: Mapping[str, Perturbation] = MappingProxyType(
    {
        "noise": Perturbation(0.0, 255.0, "gray levels"),
        "force_noise": Perturbation(0.0, 1000.0, "N"),
        "mass": Perturbation(0.01, 100.0, "times"),
        "friction": Perturbation(0.01, 100.0, "times"),
        "camera": Perturbation(-180.0, 180.0, "degrees"),
    }
)


def _as_range(value: float | Range) -> Range:
    return value if isinstance(value, tuple) else (value, value)


def _spelled(name: str) -> str:
    return name.replace("_", "-")


CHANGES: Final = tuple(map(_spelled, PERTURBATIONS))
"""What can be changed, as it is spelled on the command line."""

STANDARD: Final = Conditions()
"""The protocol's own conditions."""


def parse_conditions(without: Sequence[str], changes: Sequence[str]) -> Conditions:
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
        if spelled not in CHANGES:
            raise UsageError(f"no condition '{spelled}'; there are {', '.join(CHANGES)}")
        name = spelled.replace("-", "_")
        low, colon, high = text.partition(":")
        try:
            if isinstance(getattr(STANDARD, name), tuple):
                values[name] = (float(low), float(high if colon else low))
            else:
                values[name] = float(text)
        except ValueError:
            raise UsageError(f"'{change}' is no condition; write mass=2 or mass=0.5:2") from None
    try:
        return Conditions(without=ordered, **values)  # type: ignore[arg-type]
    except ValueError as error:
        raise UsageError(str(error)) from error
