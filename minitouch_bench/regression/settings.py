"""What a regression gate lets pass: levels and tolerances, from flags and a TOML file."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from minitouch_bench.documents import read_toml
from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.regression.pairing import COMPARED_METRICS, MEAN_METRIC, MEAN_TASK
from minitouch_bench.rendering.escaping import printable

SECTION_KEYS = ("alpha", "strict", "metrics", "tolerance")
ROWS = (*TASK_NAMES, MEAN_TASK)
"""What a tolerance may be of: a task, or the mean."""

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

    ``tolerances`` by ``METRIC`` or ``TASK.METRIC``; ``strict`` fails what is inconclusive.
    """

    alpha: float = 0.05
    strict: bool = False
    metrics: tuple[str, ...] = COMPARED_METRICS
    tolerances: Mapping[str, Tolerance] = field(default_factory=dict)

    def tolerance(self, task: str, metric: str) -> Tolerance:
        """Return the tolerance of a metric in a task: its own, the metric's, the default."""
        own = self.tolerances.get(f"{task}.{metric}") or self.tolerances.get(metric)
        return own or DEFAULT_TOLERANCES.get(metric, OTHER_TOLERANCE)


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


def with_flags(
    settings: GateSettings,
    tolerances: Sequence[str],
    *,
    alpha: float | None = None,
    strict: bool = False,
    metrics: str | None = None,
) -> GateSettings:
    """Return the settings with those of the command line in place of the file's.

    Raises:
        UsageError: a tolerance that is not ``[TASK.]METRIC=NUMBER`` or ``=NUMBER%``.
    """
    own = dict(settings.tolerances)
    for text in tolerances:
        key, sign, value = (part.strip() for part in text.partition("="))
        if not sign:
            raise UsageError(
                f"a tolerance is METRIC=NUMBER or TASK.METRIC=NUMBER, not '{printable(text)}'"
            )
        checked = _checked_key(key)
        own[checked] = _tolerance(checked, _number(value))
    names = settings.metrics
    if metrics is not None:
        names = _metrics([name.strip() for name in metrics.split(",") if name.strip()])
    return replace(
        settings,
        alpha=settings.alpha if alpha is None else _alpha(alpha),
        strict=strict or settings.strict,
        metrics=names,
        tolerances=own,
    )


def _settings(values: Any) -> GateSettings:
    table = _table(values, SECTION_KEYS, "[regress]")
    strict = table.get("strict", False)
    if not isinstance(strict, bool):
        raise UsageError("regress.strict is true or false")
    return GateSettings(
        alpha=_alpha(table.get("alpha", GateSettings.alpha)),
        strict=strict,
        metrics=_metrics(table.get("metrics", list(COMPARED_METRICS))),
        tolerances={
            key: _tolerance(key, value) for key, value in _flat(table.get("tolerance", {}))
        },
    )


def _flat(values: Any) -> Iterator[tuple[str, Any]]:
    """Walk through a table of tolerances; those of a task stand in a table of its name."""
    table = _table(values, (*COMPARED_METRICS, *ROWS), "[regress.tolerance]")
    for name, value in table.items():
        if name in ROWS:
            own = _table(value, COMPARED_METRICS, f"[regress.tolerance.{name}]")
            yield from ((_checked_key(f"{name}.{metric}"), one) for metric, one in own.items())
        else:
            yield name, value


def _table(value: Any, known: Sequence[str], name: str) -> dict[str, Any]:
    """Return a table whose keys are all known."""
    if not isinstance(value, dict):
        raise UsageError(f"{name} is a table")
    for key in value:
        if key not in known:
            raise UsageError(f"{name} has no key '{printable(key)}'; it knows {', '.join(known)}")
    return value


def _checked_key(key: str) -> str:
    """Return a tolerance's key, of a metric that can get worse in its task."""
    task, dot, metric = key.rpartition(".")
    if metric not in COMPARED_METRICS:
        known = ", ".join(COMPARED_METRICS)
        raise UsageError(f"no metric '{printable(metric)}' to tolerate; there are {known}")
    if not dot:
        return key
    if task not in ROWS:
        raise UsageError(f"no task '{printable(task)}'; there are {', '.join(ROWS)}")
    if metric != MEAN_METRIC if task == MEAN_TASK else not METRICS[metric].is_in(task):
        raise UsageError(f"{task} has no {metric}")
    if not METRICS[metric].direction_in(task):
        raise UsageError(
            f"more {metric} is neither better nor worse in {task}: nothing to tolerate"
        )
    return key


def _tolerance(key: str, value: Any) -> Tolerance:
    percent = _PERCENT.fullmatch(value.strip()) if isinstance(value, str) else None
    if percent:
        found = Tolerance(float(percent[1]) / 100.0, relative=True)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        found = Tolerance(float(value))
    else:
        raise UsageError(f"the tolerance of {key} is a number or a percentage like '10%'")
    is_share = METRICS[key.rpartition(".")[2]].is_share
    if not 0.0 <= found.amount < (1.0 if is_share else float("inf")):
        room = "from 0 to below 1" if is_share else "0 or more"
        raise UsageError(f"the tolerance of {key} is {room}, not {value}")
    return found


def _number(text: str) -> float | str:
    """Return a flag's value as a number, or as it is."""
    try:
        return float(text)
    except ValueError:
        return text


def _alpha(value: Any) -> float:
    if not isinstance(value, float) or not 0.0 < value < 0.5:
        raise UsageError(f"alpha is a number between 0 and 0.5, not {value}")
    return value


def _metrics(names: Any) -> tuple[str, ...]:
    known = ", ".join(COMPARED_METRICS)
    if not isinstance(names, list) or not names:
        raise UsageError(f"metrics is a list of some of {known}")
    for name in names:
        if name not in COMPARED_METRICS:
            raise UsageError(f"no metric '{printable(str(name))}' to guard; there are {known}")
    return tuple(metric for metric in COMPARED_METRICS if metric in names)
