"""Table 4 of the paper, for reference beside our values.

Source: "Haptics-based Curiosity for Sparse-reward Tasks", CoRL 2021, supplement, Table 4.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from minitouch_bench.reporting.tables import Cell

CITATION = "“Haptics-based Curiosity for Sparse-reward Tasks”, CoRL 2021, supplement, Table 4"
CAVEAT = "other episodes and object sets"

PAPER_TASKS = ("pushing", "opening", "pick-up", "playing")
"""The tasks in the order of Table 4."""

PAPER_METHODS = ("HaC", "RND+touch", "RND")
"""The columns of Table 4. Its Pick-up block prints "HaC-RND" over the second one, which the
caption and the text describe as RND+touch."""

OTHER_UNIT = "other unit"
"""Stands beside a value whose unit the paper does not say."""

MARK = "†"
"""Stands behind such a value in tables, where there is no room for more."""

PAPER_NOTE = (
    f"{', '.join(PAPER_METHODS)}: the paper's own values, {CAVEAT} ({CITATION}). "
    f"{MARK} {OTHER_UNIT}: the paper does not say what it counts, so it is compared with nothing."
)
"""Stands below every table with values of the paper."""

_METRICS_OF_UNKNOWN_UNIT = ("touch_interaction",)
"""No unit we tried reproduces the paper's values: random actions reach 550 to 990 ticks in the
released package, above the paper's best method in Playing."""

_PRINTED: Mapping[tuple[str, str], tuple[str, str, str]] = MappingProxyType(
    {
        ("pushing", "exploration"): ("0.403", "0.181", "0.077"),
        ("opening", "exploration"): ("0.669", "0.564", "0.380"),
        ("pick-up", "exploration"): ("0.063", "0.013", "0.005"),
        ("pushing", "success"): ("0.733", "0.710", "0.582"),
        ("opening", "success"): ("0.983", "0.921", "0.875"),
        ("pick-up", "success"): ("0.891", "0.593", "0.450"),
        ("pushing", "episode_steps"): ("57.84", "55.20", "97.51"),
        ("opening", "episode_steps"): ("23.34", "23.54", "37.92"),
        ("pick-up", "episode_steps"): ("30.54", "52.29", "89.88"),
        ("pushing", "touch_interaction"): ("247.79", "227.75", "206.02"),
        ("opening", "touch_interaction"): ("600.1", "411.43", "194.22"),
        ("pick-up", "touch_interaction"): ("980.7", "894.5", "725.1"),
        ("playing", "touch_interaction"): ("388.15", "312.0", "124.5"),
    }
)


@dataclass(frozen=True)
class PaperValue:
    """A value as the paper prints it.

    Where ``is_our_unit`` is false it counts something else than ours: it is shown as OTHER_UNIT,
    never drawn on an axis of ours, never sorted among ours and never called better or worse.
    """

    text: str
    is_our_unit: bool

    @property
    def number(self) -> float | None:
        """The value as a number to set beside ours, None in another unit."""
        return float(self.text) if self.is_our_unit else None

    @property
    def remark(self) -> str:
        """What must be said beside the value, "" if nothing."""
        return "" if self.is_our_unit else OTHER_UNIT


def paper_value(task: str, metric: str, method: str) -> PaperValue | None:
    """Return a value of Table 4, None where the paper gives none."""
    printed = _PRINTED.get((task, metric))
    if printed is None:
        return None
    text = printed[PAPER_METHODS.index(method)]
    return PaperValue(text, is_our_unit=metric not in _METRICS_OF_UNKNOWN_UNIT)


def paper_values(method: str) -> dict[tuple[str, str], PaperValue]:
    """Return every value of a method, by task and metric."""
    values = {key: paper_value(*key, method) for key in _PRINTED}
    return {key: value for key, value in values.items() if value is not None}


def paper_cell(task: str, metric: str, method: str) -> Cell:
    """Write a value of the paper; one in another unit is marked, and no number to sort by."""
    value = paper_value(task, metric, method)
    if value is None:
        return Cell()
    text = value.text if value.is_our_unit else value.text + MARK
    title = ", ".join(filter(None, ("as printed in the paper", value.remark)))
    return Cell(text, title=title, sort_key=value.number)
