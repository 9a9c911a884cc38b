"""What a regression gate lets pass: level, metric and tolerance."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from minitouch_bench.comparison.pairing import COMPARED_METRICS, MEAN_METRIC
from minitouch_bench.errors import UsageError, printable
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.significance import ALPHA

SMALLEST_ALPHA, LARGEST_ALPHA = 0.001, 0.25
"""The levels that a gate can have. A test at a smaller level finds nothing: with a level of 1e-9
even 29 lost episodes of 29 are not a regression."""


@dataclass(frozen=True)
class Tolerance:
    """How much worse a metric may get: an amount in its unit, or a part of the baseline's mean."""

    amount: float
    relative: bool = False

    @classmethod
    def parse(cls, given: float | str) -> "Tolerance":
        """Read "0.05", or "10%" of the baseline's mean.

        Raises:
            UsageError: it is neither.
        """
        text = str(given).strip()
        try:
            amount = float(text.removesuffix("%"))
        except ValueError:
            raise UsageError("the tolerance is one number, or a percentage like '10%'") from None
        return cls(amount / 100.0, relative=True) if text.endswith("%") else cls(amount)

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

    Raises:
        UsageError: a value has no meaning.
    """

    alpha: float = ALPHA
    metric: str = ""
    tolerance: Tolerance | None = None
    strict: bool = False
    lenient: bool = False

    def __post_init__(self) -> None:
        if not SMALLEST_ALPHA <= self.alpha <= LARGEST_ALPHA:
            raise UsageError(f"alpha is from {SMALLEST_ALPHA} to {LARGEST_ALPHA}, not {self.alpha}")
        if self.metric and self.metric not in COMPARED_METRICS:
            known = ", ".join(COMPARED_METRICS)
            raise UsageError(f"no metric '{printable(self.metric)}' to guard; there are {known}")
        if self.strict and self.lenient:
            raise UsageError("a gate is strict or lenient, not both")
        is_share = METRICS[self.metric or MEAN_METRIC].is_share
        if self.tolerance and not 0.0 <= self.tolerance.amount < (1.0 if is_share else math.inf):
            room = "from 0 to below 1" if is_share else "0 or more"
            raise UsageError(f"the tolerance is {room}, not {self.tolerance}")

    def tolerance_of(self, metric: str) -> Tolerance:
        """Return the tolerance of the endpoint's metric."""
        return self.tolerance or DEFAULT_TOLERANCES.get(metric, OTHER_TOLERANCE)

    def as_options(self) -> list[str]:
        """Return the options of ``regress`` for what differs from STANDARD."""
        words = []
        for name, value in vars(self).items():
            if value != getattr(STANDARD, name):
                words += [f"--{name}"] if value is True else [f"--{name}", str(value)]
        return words


STANDARD = GateSettings()
"""What the gate asks for where nobody says otherwise."""
