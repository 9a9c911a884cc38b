"""The colors of pages and files, each in a light and a dark shade."""

from collections.abc import Mapping
from types import MappingProxyType

COLORS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "page": ("#fbfbf9", "#14161a"),
        "panel": ("#ffffff", "#1b1e23"),
        "tint": ("#f3f4f0", "#1f2329"),
        "ink": ("#1b1d20", "#e7e8ea"),
        "muted": ("#5c636c", "#a0a7b1"),
        "rule": ("#e2e3df", "#30343b"),
        "official": ("#00704f", "#4ad1a8"),
        "warn": ("#a34700", "#f5a56b"),
        "series-0": ("#0072b2", "#56b4e9"),
        "series-1": ("#d55e00", "#f0803c"),
        "series-2": ("#009e73", "#2fc59a"),
        "series-3": ("#aa4488", "#dd94bd"),
        "series-4": ("#b87a00", "#e6b13a"),
        "series-5": ("#5d2f0c", "#f2dfc8"),
        "series-6": ("#878d96", "#99a0a9"),
        "success": ("#009e73", "#2fb68d"),
        "touched": ("#3b8fc4", "#8ecdf2"),
        "failed": ("#e69f00", "#e6b13a"),
        "left": ("#aa4488", "#dd94bd"),
        "limit": ("#9aa1a9", "#7d858f"),
        "fault": ("#d55e00", "#f0803c"),
    }
)
"""Light and dark shade by name. A mark of a chart names its color as ``tone``."""

SERIES = tuple(name for name in COLORS if name.startswith("series-"))
"""The colors of runs, in the order they are given out."""


def series_tone(index: int) -> str:
    """Return the color of the run at this position; the eighth has that of the first."""
    return SERIES[index % len(SERIES)]
