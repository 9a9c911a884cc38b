"""What a regression gate lets pass: level, metric and tolerance, from flags and a TOML file."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from minitouch_bench.documents import read_toml
from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.regression.pairing import COMPARED_METRICS, MEAN_METRIC
from minitouch_bench.rendering.escaping import printable

SECTION_KEYS = ("alpha", "metric", "tolerance", "strict", "lenient")

_PERCENT = re.compile(r"(\d+(?:\.\d+)?)\s*%")


@dataclass(frozen=True)
class Tolerance:
    """How much worse a metric may get: an amount in its unit, or a part of the baseline's mean."""

    amount: float
    relative: bool = False

    def absolute(self, baseline: float) -> float:
        """Return the tolerance in the metric's unit, for a mean of the baseline."""
        return self.amount * abs(baseline) if self.relative else self.amount

    def __str__(self) -> str:
        return f"{100 * self.amount:g}%" if self.relative else f"{self.amount:g}"


DEFAULT_TOLERANCES: Mapping[str, Tolerance] = {
    "success": Tolerance(0.05),
    "exploration": Tolerance(0.05),
    "episode_steps": Tolerance(0.10, relative=True),
}
"""By metric: 5 points of success, a tenth of the steps."""

OTHER_TOLERANCE = Tolerance(0.20, relative=True)
"""Of every other metric."""


@dataclass(frozen=True)
class GateSettings:
    """What the gate asks for.

    ``metric``: what the endpoint is the mean of; "" for success, or for the touch share where no
    task has a goal. ``tolerance``: None for the metric's default. Where there are not enough
    episodes, ``strict`` always fails and ``lenient`` never does.
    """

    alpha: float = 0.05
    metric: str = ""
    tolerance: Tolerance | None = None
    strict: bool = False
    lenient: bool = False

    def tolerance_of(self, metric: str) -> Tolerance:
        """Return the tolerance of the endpoint's metric."""
        return self.tolerance or DEFAULT_TOLERANCES.get(metric, OTHER_TOLERANCE)


STANDARD = GateSettings()
"""What the gate asks for where nobody says otherwise."""


def read_settings(file: Path) -> GateSettings:
    """Read the table ``[regress]`` of a TOML file; a file without it changes nothing.

    Raises:
        UsageError: the file is not TOML, or names what is unknown or has no meaning.
    """
    document = read_toml(file)
    try:
        return _settings(document.get("regress", {}))
    except UsageError as error:
        raise UsageError(f"{file}: {error}") from error


def with_flags(settings: GateSettings, **flags: Any) -> GateSettings:
    """Return the settings with those of the command line in place of the file's.

    A flag that is None or False leaves the file's setting, except that ``strict`` and ``lenient``
    each replace the other.

    Raises:
        UsageError: a value has no meaning.
    """
    given = {
        name: value for name, value in flags.items() if value is not None and value is not False
    }
    if "strict" in given or "lenient" in given:
        settings = replace(settings, strict=False, lenient=False)
    return _checked(replace(settings, **given))


def _settings(values: Any) -> GateSettings:
    if not isinstance(values, dict):
        raise UsageError("[regress] is a table")
    for key in values:
        if key not in SECTION_KEYS:
            known = ", ".join(SECTION_KEYS)
            raise UsageError(f"[regress] has no key '{printable(key)}'; it knows {known}")
    return _checked(GateSettings(**values))


def _checked(settings: GateSettings) -> GateSettings:
    """Return settings whose values have a meaning together; a tolerance may still be text."""
    alpha, metric = settings.alpha, settings.metric
    if not isinstance(alpha, float) or not 0.0 < alpha < 0.5:
        raise UsageError(f"alpha is a number between 0 and 0.5, not {alpha}")
    if metric and metric not in COMPARED_METRICS:
        known = ", ".join(COMPARED_METRICS)
        raise UsageError(f"no metric '{printable(str(metric))}' to guard; there are {known}")
    for name in ("strict", "lenient"):
        if not isinstance(getattr(settings, name), bool):
            raise UsageError(f"regress.{name} is true or false")
    if settings.strict and settings.lenient:
        raise UsageError("a gate is strict or lenient, not both")
    tolerance = settings.tolerance
    return replace(settings, tolerance=None if tolerance is None else _tolerance(tolerance, metric))


def _tolerance(value: Any, metric: str) -> Tolerance:
    """Read a tolerance of a metric, or check the one that there is."""
    tolerance = value if isinstance(value, Tolerance) else _parse(value)
    if tolerance is None:
        raise UsageError("the tolerance is one number, or a percentage like '10%'")
    is_share = METRICS[metric or MEAN_METRIC].is_share
    if not 0.0 <= tolerance.amount < (1.0 if is_share else float("inf")):
        room = "from 0 to below 1" if is_share else "0 or more"
        raise UsageError(f"the tolerance is {room}, not {printable(str(value))}")
    return tolerance


def _parse(value: Any) -> Tolerance | None:
    if isinstance(value, str):
        if percent := _PERCENT.fullmatch(value.strip()):
            return Tolerance(float(percent[1]) / 100.0, relative=True)
        try:
            return Tolerance(float(value))
        except ValueError:
            return None
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return Tolerance(float(value)) if is_number else None
