"""Under which conditions a policy plays: changed senses and a changed world."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, get_args

import msgspec
import numpy as np

from minitouch_bench.errors import UsageError
from minitouch_bench.text import exact

Sense = Literal["touch", "forces", "vision"]
Range = tuple[float, float]

SENSES: Final[tuple[Sense, ...]] = get_args(Sense)
"""What can be taken away: the touch vector, its finger forces alone, the picture."""


@dataclass(frozen=True)
class DrawnConditions:
    """What one episode has of the conditions that are ranges, in the order of their draws."""

    mass: float = 1.0
    friction: float = 1.0
    camera: float = 0.0
    delay: int = 0
    grip: float = 1.0
    light: float = 1.0


class Perturbation(msgspec.Struct, frozen=True, omit_defaults=True):
    """What differs from the protocol in the senses and the world. A run with any is unofficial.

    What is as usual is not written to ``run.json``, so a new condition changes no stored run.

    A sense in ``without`` stays as it is at the reset, and so gets no noise. ``noise`` (gray
    levels) and ``force_noise`` (N) are standard deviations of normal noise on each pixel and each
    force; the sum is clipped to the observation's range.
    The others are ranges, drawn uniformly in each episode: factors on the ``mass`` and the
    ``friction`` of the object or the door, the degrees by which the ``camera`` is turned around
    what it looks at, the whole number of control steps by which observations are late
    (``delay``), the factor on the motor force of the fingers (``grip``), and that on the gray
    levels of pictures (``light``: 0 is black; None for the suite's).
    Pictures get the light first; then senses get noise, then the delay, and are left out last.

    Raises:
        ValueError: a value that means nothing.
    """

    without: tuple[Sense, ...] = ()
    noise: float = 0.0
    force_noise: float = 0.0
    mass: Range = (1.0, 1.0)
    friction: Range = (1.0, 1.0)
    camera: Range = (0.0, 0.0)
    delay: tuple[int, int] = (0, 0)
    grip: Range = (1.0, 1.0)
    light: Range | None = None

    def __post_init__(self) -> None:
        if self.without != tuple(sense for sense in SENSES if sense in self.without):
            raise ValueError(f"senses are {', '.join(SENSES)}, each once and in this order")
        for name, senses in _NOISY.items():
            if getattr(self, name) and (frozen := senses.intersection(self.without)):
                what = f"{_spelled(name)} changes a sense that stays as at the reset"
                raise ValueError(f"{what}: leave it out, or leave out --without {min(frozen)}")
        for name, (least, most, unit) in _ALLOWED.items():
            low, high = _as_range(getattr(self, name))
            if not least <= low <= high <= most:
                order = ", the smaller value first" if low > high else ""
                raise ValueError(f"{_spelled(name)} is {least:g} to {most:g} {unit}{order}")

    @property
    def changes_senses(self) -> bool:
        """Whether a policy is given other observations than the environment's."""
        changes_picture = self.noise or _as_range(self.light) != (1.0, 1.0)
        return bool(self.without or changes_picture or self.force_noise or self.changes_touch)

    @property
    def changes_touch(self) -> bool:
        """Whether a policy is given another touch vector than the environment's, as a whole."""
        return "touch" in self.without or self.delay != UNPERTURBED.delay

    @property
    def changes_forces(self) -> bool:
        """Whether a policy is given other forces than those of its fingers."""
        return bool("forces" in self.without or self.force_noise or self.changes_touch)

    def draw(self, rng: np.random.Generator) -> DrawnConditions:
        """Draw the conditions of one episode: one number each, a new condition at the end."""
        least, most = self.delay
        return DrawnConditions(
            mass=rng.uniform(*self.mass),
            friction=rng.uniform(*self.friction),
            camera=rng.uniform(*self.camera),
            delay=min(int(rng.uniform(least, most + 1)), most),
            grip=rng.uniform(*self.grip),
            light=rng.uniform(*_as_range(self.light)),
        )

    def in_words(self) -> tuple[str, ...]:
        """Return what is different, for people."""
        changed = (
            _LIGHTS.get((name, text))
            or f"{name} {text.replace(':', ' to ')} {_ALLOWED[name.replace('-', '_')][2]}"
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
                yield _spelled(name), ":".join(map(exact, dict.fromkeys((low, high))))


_ALLOWED: Mapping[str, tuple[float, float, str]] = {
    "noise": (0.0, 255.0, "gray levels"),
    "force_noise": (0.0, 1000.0, "N"),
    "mass": (0.01, 100.0, "times"),
    "friction": (0.01, 100.0, "times"),
    "camera": (-180.0, 180.0, "degrees"),
    "delay": (0, 100, "control steps"),
    "grip": (0.01, 10.0, "times"),
    "light": (0.0, 100.0, "times"),
}
"""The least and the greatest value of each change, and their unit."""

_LIGHTS = {("light", "0"): "light off", ("light", "1"): "light on"}
"""Words for the two lights that a suite has."""

_NOISY: Mapping[str, frozenset[Sense]] = {
    "noise": frozenset({"vision"}),
    "force_noise": frozenset({"touch", "forces"}),
}
"""The senses that each kind of noise is added to."""


def _as_range(value: float | Range | None) -> Range:
    """Return a condition as a range; a light that is None is the suite's, unchanged."""
    value = 1.0 if value is None else value
    return value if isinstance(value, tuple) else (value, value)


def _spelled(name: str) -> str:
    return name.replace("_", "-")


PERTURBATION_NAMES: Final = tuple(map(_spelled, _ALLOWED))
"""What can be changed, as it is spelled on the command line."""

AS_USUAL: Final = DrawnConditions()
"""What an episode has under the protocol's own conditions."""

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
        if name in values:
            raise UsageError(f"the condition '{spelled}' is given twice")
        is_range = name not in _NOISY
        number, ranges = (int, "1:3") if name == "delay" else (float, "0.5:2")
        low, colon, high = text.partition(":") if is_range else (text, "", "")
        try:
            values[name] = (
                (number(low), number(high if colon else low)) if is_range else number(low)
            )
        except ValueError:
            possible = f" or {spelled}={ranges}" if is_range else ""
            what = f"'{change}' is no condition; write {spelled}=2{possible}"
            raise UsageError(what) from None
    # Msgspec omits a default where it is the same object, not where it is equal.
    unusual = {name: value for name, value in values.items() if value != getattr(UNPERTURBED, name)}
    try:
        return Perturbation(without=ordered, **unusual)  # type: ignore[arg-type]
    except ValueError as error:
        raise UsageError(str(error)) from error
