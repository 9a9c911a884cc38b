"""The command ``tasks``: what the tasks are."""

import json
from dataclasses import asdict

from minitouch_bench.cli import options
from minitouch_bench.cli.console import data_console
from minitouch_bench.protocol.minitouch import PROTOCOL

HEADINGS = (
    "Gymnasium id", "action", "workspace x; y; z (m)", "objects", "steps", "success",
)  # fmt: skip


def tasks(as_json: options.AsJson = False) -> None:
    """List the tasks: Gymnasium id, action, workspace, objects, and what counts as success."""
    if as_json:
        listed = [
            {
                "name": task.name,
                "gym_id": task.gym_id,
                "action_size": task.action_size,
                "workspace": asdict(task.workspace),
                "objects": task.default_objects,
                "max_steps": task.max_steps,
                "goal": task.goal,
            }
            for task in PROTOCOL.tasks
        ]
        suites = [asdict(suite) for suite in PROTOCOL.suites]
        print(json.dumps({"protocol": PROTOCOL.name, "tasks": listed, "suites": suites}, indent=1))
        return
    from minitouch_bench.reporting import tables

    rows = []
    for task in PROTOCOL.tasks:
        ranges = zip(task.workspace.low, task.workspace.high, strict=True)
        row = tables.make_row(
            task.name,
            task.gym_id,
            f"float32 ({task.action_size},)",
            "; ".join(f"{low:g} to {high:g}" for low, high in ranges),
            task.default_objects or "cabinet",
            f"at most {task.max_steps}",
            task.goal or "none: touch is the metric",
        )
        rows.append(row)
    columns = tables.make_columns(*HEADINGS, words=HEADINGS)
    title = f"Tasks of the protocol {PROTOCOL.name}"
    tables.show([tables.Table(title, ("task",), columns, tuple(rows))], data_console())
