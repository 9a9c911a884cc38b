"""The protocol's digest: runs with different ones are never compared."""

import hashlib
import json
from dataclasses import asdict, is_dataclass
from functools import cache
from typing import Any

import numpy as np

from minitouch_bench.cache import content_digest
from minitouch_bench.protocol.seeds import PROTOCOL
from minitouch_bench.sensing import camera, touch
from minitouch_bench.simulation import bodies, client, panda_arm, panda_kinematics, scene
from minitouch_bench.simulation.arm_assets import light_panda
from minitouch_bench.simulation.installed import simulator_version
from minitouch_bench.tasks import opening, pick_up, playing, pushing, tabletop, task
from minitouch_bench.tasks.registration import TASKS, shape_set_digest

RULES = 2
"""Raised when code changes an episode without changing a constant."""

MODULES = (
    bodies, camera, client, opening, panda_arm, panda_kinematics, pick_up, playing, pushing, scene,
    tabletop, task, touch,
)  # fmt: skip

FOR_PEOPLE = ("portrait", "goal")
"""Fields of a preset that no episode depends on."""


def protocol_constants() -> dict[str, Any]:
    """Return every public constant of the protocol's modules, by ``module.NAME``."""
    return {
        f"{module.__name__.removeprefix('minitouch_bench.')}.{name}": _plain(value)
        for module in MODULES
        for name, value in sorted(vars(module).items())
        if name.isupper() and "PORTRAIT" not in name and not isinstance(value, type)
    }


@cache
def protocol_digest() -> str:
    """Return the SHA-256 over the rules, constants, presets, assets, shapes and simulator."""
    assets = light_panda().parent
    content = {
        "protocol": PROTOCOL,
        "rules": RULES,
        "simulator": simulator_version(),
        "constants": protocol_constants(),
        "presets": {name: _preset(task_class) for name, task_class in TASKS.items()},
        "arm": content_digest(sorted(assets.iterdir())),
        "shapes": shape_set_digest(),
    }
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _preset(task_class: type[task.Task]) -> dict[str, Any]:
    fields = asdict(task_class.preset)
    return {name: value for name, value in fields.items() if name not in FOR_PEOPLE}


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, slice):
        return [value.start, value.stop]
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return value
