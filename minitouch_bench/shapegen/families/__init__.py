"""Families of shapes: one file each, a pure function of a random generator.

A family returns a closed solid of any size; ``normalise`` gives it its size and its frame.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from minitouch_bench.shapegen.families.carved import carved
from minitouch_bench.shapegen.families.extruded import extruded
from minitouch_bench.shapegen.families.handled import handled
from minitouch_bench.shapegen.families.harmonic import harmonic
from minitouch_bench.shapegen.families.lathed import lathed
from minitouch_bench.shapegen.families.melted import melted
from minitouch_bench.shapegen.families.stacked import stacked
from minitouch_bench.shapegen.families.twisted import twisted
from minitouch_bench.shapegen.solids import Solid

Family = Callable[[np.random.Generator], Solid]

FAMILIES: Mapping[str, Family] = MappingProxyType(
    {
        "harmonic": harmonic,
        "melted": melted,
        "carved": carved,
        "lathed": lathed,
        "extruded": extruded,
        "twisted": twisted,
        "handled": handled,
        "stacked": stacked,
    }
)
"""Every family by name; shape i belongs to family i modulo their number."""
