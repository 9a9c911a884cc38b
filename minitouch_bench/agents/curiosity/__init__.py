"""Curiosity: what pays an agent for itself, one file per idea."""

from minitouch_bench.agents.config import CuriosityConfig
from minitouch_bench.agents.curiosity.curiosity import Curiosity
from minitouch_bench.agents.curiosity.disagreement import Disagreement
from minitouch_bench.agents.curiosity.hac import HapticCuriosity
from minitouch_bench.agents.curiosity.icm import InverseDynamics
from minitouch_bench.agents.curiosity.rnd import RandomDistillation


def make_curiosity(method: str, config: CuriosityConfig, action_size: int) -> Curiosity | None:
    """Return the curiosity of a method, None for ``sac``, which has none."""
    match method:
        case "hac":
            return HapticCuriosity(config, action_size)
        case "icm" | "icm-touch":
            return InverseDynamics(config, action_size, touch=method == "icm-touch")
        case "disagreement":
            return Disagreement(config, action_size)
        case "rnd" | "rnd-touch":
            return RandomDistillation(config, touch=method == "rnd-touch")
    return None


__all__ = ["Curiosity", "make_curiosity"]
