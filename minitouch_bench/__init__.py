"""MiniTouch-bench: evaluation harness and leaderboard of the MiniTouch benchmark.

Importing it registers the four tasks with Gymnasium, and imports no simulator:
``gymnasium.make("minitouch_bench:MiniTouch/Pushing-v1")`` needs nothing else.
"""

import gymnasium

from minitouch_bench.protocol.minitouch import PROTOCOL, TASK_NAMES


def register_environments() -> None:
    """Register the tasks with Gymnasium, once."""
    for task in TASK_NAMES:
        if PROTOCOL.task(task).gym_id not in gymnasium.registry:
            gymnasium.register(
                PROTOCOL.task(task).gym_id,
                entry_point="minitouch_bench.tasks.registration:make_environment",
                kwargs={"task": task},
            )


register_environments()
