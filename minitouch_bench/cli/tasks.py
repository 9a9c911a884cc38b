"""``minitouch-bench tasks``: what the tasks are."""

from minitouch_bench.cli.console import data_console
from minitouch_bench.protocol.minitouch import PROTOCOL

HEADINGS = (
    "task",
    "Gymnasium id",
    "action",
    "workspace x; y; z (m)",
    "objects",
    "steps",
    "success",
)


def tasks() -> None:
    """List the tasks: Gymnasium id, action, workspace, objects, and what counts as success."""
    from rich.table import Table

    table = Table(title=f"Tasks of the protocol {PROTOCOL.name}", title_justify="left")
    for heading in HEADINGS:
        table.add_column(heading)
    for task in PROTOCOL.tasks:
        ranges = zip(task.workspace.low, task.workspace.high, strict=True)
        table.add_row(
            task.name,
            task.gym_id,
            f"float32 ({task.action_size},)",
            "; ".join(f"{low:g} to {high:g}" for low, high in ranges),
            task.default_objects or "cabinet",
            f"at most {task.max_steps}",
            task.goal or "none: touch is the metric",
        )
    data_console().print(table)
