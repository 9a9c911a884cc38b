"""Curiosity: what pays an agent for itself, one file per method."""

from minitouch_bench.agents import METHODS
from minitouch_bench.agents.config import CuriosityConfig
from minitouch_bench.agents.curiosity.curiosity import Curiosity
from minitouch_bench.optional import look_up


def make_curiosity(method: str, config: CuriosityConfig, action_size: int) -> Curiosity | None:
    """Return the curiosity of a method, None for ``sac``, which has none."""
    if not METHODS[method]:
        return None
    curiosity: Curiosity = look_up(f"{__name__}.{METHODS[method]}")(config, action_size)
    return curiosity
