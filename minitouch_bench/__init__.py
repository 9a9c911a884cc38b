"""MiniTouch-bench: evaluation harness and leaderboard of the MiniTouch benchmark.

::

    import minitouch_bench as mt

    run = mt.evaluate("my_policy.onnx", suite="smoke")
    run["pushing"].success.value
    run.table4()

The import registers the tasks with Gymnasium, for ``gymnasium.make("MiniTouch/Pushing-v1")``.
Simulator, torch and pandas are imported when they are first needed. See
``docs/reference/python-api.md``.
"""

import importlib
import os
import signal
import sys
from typing import TYPE_CHECKING, Any


def _end_loading(*_: object) -> None:
    """End the command, which is still loading."""
    os.write(2, b"minitouch-bench: interrupted\n")
    os._exit(130)


# Importing any module of the command imports this package first, which takes half a second: only
# here can Ctrl-C be kept from ending it with a traceback. Later ``__main__`` handles it.
_program = os.path.basename(sys.argv[0]) if sys.argv else ""
_is_command = _program == "minitouch-bench" or (
    _program == "-m" and "minitouch_bench" in sys.orig_argv
)
if _is_command and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, _end_loading)

import gymnasium  # noqa: E402
from gymnasium.envs.registration import WrapperSpec  # noqa: E402

from minitouch_bench.protocol.minitouch import PROTOCOL  # noqa: E402

if TYPE_CHECKING:
    from minitouch_bench.api import (
        Run,
        TaskResult,
        compare,
        compare_methods,
        evaluate,
        export,
        load_run,
        make,
        replay,
        train,
    )
    from minitouch_bench.errors import MiniTouchError

    __version__: str

__all__ = [
    "MiniTouchError", "Run", "TaskResult", "__version__", "compare", "compare_methods", "evaluate",
    "export", "load_run", "make", "replay", "train",
]  # fmt: skip


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


for _task in PROTOCOL.tasks:
    if _task.gym_id not in gymnasium.registry:  # an interactive session can load a module again
        gymnasium.register(
            _task.gym_id,
            entry_point="minitouch_bench.tasks.environment:MiniTouchEnv",
            max_episode_steps=_task.max_steps,  # Gymnasium's limit is the only one
            kwargs={"task": _task.name, "max_episode_steps": sys.maxsize},
            additional_wrappers=(
                WrapperSpec("EpisodeEnd", "minitouch_bench.tasks.environment:EpisodeEnd", {}),
            ),
        )
