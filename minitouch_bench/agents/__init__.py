"""Learning agents: soft actor-critic, curiosity bonuses, and their training in two phases.

Nothing here imports torch, so that the command line's help can name the methods.
"""

from collections.abc import Mapping
from types import MappingProxyType

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
