"""Families of shapes: each a pure function of a random generator.

A family returns a closed solid of any size; ``build.sized`` gives it its size and its frame.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from minitouch_bench.shapegen.families.blocks import carved, stacked
from minitouch_bench.shapegen.families.household import handled, lathed
from minitouch_bench.shapegen.families.prisms import extruded, twisted
from minitouch_bench.shapegen.families.smooth import harmonic, melted
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
"""Every family by name; shape i belongs to family i modulo their number.

So another entry makes other sets: raise GENERATOR_VERSION, generate ``shapes/`` again, and set
its digest in ``protocol/minitouch.py``.
"""

GENERATOR_VERSION = 2
"""Raised whenever the same seed would give another shape."""
