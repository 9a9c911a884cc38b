"""MiniTouch-bench: evaluation harness and leaderboard of the MiniTouch benchmark.

::

    import minitouch_bench as mt

    run = mt.evaluate("my_policy.onnx", suite="smoke")
    run["pushing"].success.value
    run.table4()

Importing it is cheap: Gymnasium, simulator, torch and pandas are imported when they are first
needed, and Gymnasium then knows the tasks. See ``docs/reference/python-api.md``.
"""

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import TYPE_CHECKING, Any

from minitouch_bench.protocol.minitouch import PROTOCOL

if TYPE_CHECKING:
    from minitouch_bench.api import Run, TaskResult, compare, evaluate, load_run, make, train
    from minitouch_bench.errors import MiniTouchError

    __version__: str

__all__ = [
    "MiniTouchError",
    "Run",
    "TaskResult",
    "__version__",
    "compare",
    "evaluate",
    "load_run",
    "make",
    "train",
]


class _GymnasiumImport:
    """Register the tasks as soon as Gymnasium is imported, which takes 0.2 s that help need not."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Let the other finders find Gymnasium, and add the registration to its loading."""
        if name != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is None or spec.loader is None:
            return None
        load = spec.loader.exec_module

        def load_and_register(module: ModuleType) -> None:
            load(module)
            _register_environments(module)

        spec.loader.exec_module = load_and_register  # type: ignore[method-assign]
        return spec


def _register_environments(gymnasium: ModuleType) -> None:
    """Register the tasks with Gymnasium, once."""
    for task in PROTOCOL.tasks:
        if task.gym_id not in gymnasium.registry:
            gymnasium.register(
                task.gym_id,
                entry_point="minitouch_bench.tasks.environment:MiniTouchEnv",
                max_episode_steps=task.max_steps,
                kwargs={"task": task.name},
            )


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("minitouch-bench")
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    module = "errors" if name == "MiniTouchError" else "api"
    return getattr(importlib.import_module(f"minitouch_bench.{module}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


if "gymnasium" in sys.modules:
    _register_environments(sys.modules["gymnasium"])
else:
    sys.meta_path.insert(0, _GymnasiumImport())
