"""Curiosity: what pays an agent for itself, one file per method, and the table of them.

Nothing here imports torch, so that the command line's help can name the methods.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

from minitouch_bench.optional import look_up

if TYPE_CHECKING:
    from minitouch_bench.agents.config import CuriosityConfig
    from minitouch_bench.agents.curiosity.curiosity import Curiosity

METHODS: Mapping[str, str] = MappingProxyType(
    {
        "sac": "",
        "hac": "hac:HapticCuriosity",
        "icm": "icm:InverseDynamics",
        "icm-touch": "icm:TouchInverseDynamics",
        "disagreement": "disagreement:Disagreement",
        "rnd": "rnd:RandomDistillation",
        "rnd-touch": "rnd:TouchDistillation",
    }
)
"""Every method with the class of its curiosity, as ``module:name``; ``sac`` has none."""


def make_curiosity(method: str, config: "CuriosityConfig", action_size: int) -> "Curiosity | None":
    """Return the curiosity of a method, None for ``sac``, which has none."""
    if not METHODS[method]:
        return None
    curiosity: Curiosity = look_up(f"{__name__}.{METHODS[method]}")(config, action_size)
    return curiosity
