"""``minitouch-bench tasks``: what the tasks are."""

from rich.table import Table

from minitouch_bench.cli.consoles import data_console
from minitouch_bench.protocol.minitouch import PROTOCOL


def tasks() -> None:
    """List the tasks: Gymnasium id, action, workspace, objects, and what counts as success."""
    table = Table(
        title=f"MiniTouch tasks, control steps at most: {PROTOCOL.tasks[0].max_steps}",
        title_justify="left",
    )
    for heading in (
        "task",
        "Gymnasium id",
        "action",
        "workspace x; y; z (m)",
        "objects",
        "success",
    ):
        table.add_column(heading)
    for task in PROTOCOL.tasks:
        ranges = zip(task.workspace.low, task.workspace.high, strict=True)
        table.add_row(
            task.name,
            task.gym_id,
            f"float32 ({task.action_size},)",
            "; ".join(f"{low:g} to {high:g}" for low, high in ranges),
            task.default_objects or "cabinet",
            task.goal or "none: touch is the metric",
        )
    data_console().print(table)
