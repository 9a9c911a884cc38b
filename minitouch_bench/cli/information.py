"""``minitouch-bench tasks`` and ``doctor``: what the tasks are, and what this machine can do."""

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

import typer

from minitouch_bench.cli.console import data_console, notes
from minitouch_bench.errors import CHECK_FAILED
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.workflows import options

if TYPE_CHECKING:
    from minitouch_bench.verification.doctor import Check

SIGNS = {"ok": "[green]ok[/]", "note": "[cyan]note[/]", "fail": "[red]FAIL[/]"}
"""What is printed by verdict."""

HEADINGS = (
    "task", "Gymnasium id", "action", "workspace x; y; z (m)", "objects", "steps", "success",
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
    from rich.table import Table

    table = Table(*HEADINGS, title=f"Tasks of the protocol {PROTOCOL.name}", title_justify="left")
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


def doctor(workers: options.Workers = options.AUTO, as_json: options.AsJson = False) -> None:
    """Check the installation, the sandbox, and that this machine repeats its own bits."""
    from minitouch_bench.processes import core_count
    from minitouch_bench.verification.doctor import CheckResult, examine

    count = options.engine_options("local", workers, None).workers or core_count()
    checks: list[Check] = []
    with notes.status("examining") as status:
        for check in examine(count):
            checks.append(check)
            status.update(f"{check.name}: {check.verdict}")
    failed = [check.name for check in checks if check.verdict is CheckResult.FAIL]
    if as_json:
        print(json.dumps({"healthy": not failed, "checks": [asdict(c) for c in checks]}, indent=1))
    else:
        _show_checks(checks, failed)
    if failed:
        raise typer.Exit(CHECK_FAILED)


def _show_checks(checks: "list[Check]", failed: list[str]) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None, pad_edge=False)
    for check in checks:
        table.add_row(SIGNS[check.verdict], check.name, Text(check.text))
    console = data_console()
    console.print(table)
    if failed:
        console.print(f"\nNot to be trusted yet: {', '.join(failed)}", style="bold red")
    else:
        console.print("\nThis machine can be trusted with an evaluation.", style="bold green")
