"""``minitouch-bench tasks``: what the tasks are."""

from rich.table import Table

from minitouch_bench.cli.consoles import data_console
from minitouch_bench.records import gym_id
from minitouch_bench.tasks.registration import TASKS
from minitouch_bench.tasks.task import MAX_STEPS


def tasks() -> None:
    """List the tasks: Gymnasium id, action, workspace, objects, and what counts as success."""
    table = Table(title=f"MiniTouch tasks, {MAX_STEPS} control steps at most", title_justify="left")
    for heading in (
        "task",
        "Gymnasium id",
        "action",
        "workspace x; y; z (m)",
        "objects",
        "success",
    ):
        table.add_column(heading)
    for name, task in TASKS.items():
        preset = task.preset
        ranges = zip(preset.workspace.low, preset.workspace.high, strict=True)
        table.add_row(
            name,
            gym_id(name),
            f"float32 ({preset.arm.action_size},)",
            "; ".join(f"{low:g} to {high:g}" for low, high in ranges),
            preset.default_objects or "cabinet",
            preset.goal,
        )
    data_console().print(table)
