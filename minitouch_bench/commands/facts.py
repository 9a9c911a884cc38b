"""The commands ``tasks`` and ``doctor``: what there is to play, and what this machine can do."""

import json
from collections.abc import Iterable
from dataclasses import asdict

import typer

from minitouch_bench.commands import options
from minitouch_bench.console import data_console, notes
from minitouch_bench.errors import CHECK_FAILED
from minitouch_bench.evaluation.engine import AUTO, worker_count
from minitouch_bench.protocol.minitouch import PROTOCOL


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
    rows = []
    for task in PROTOCOL.tasks:
        ranges = zip(task.workspace.low, task.workspace.high, strict=True)
        cells = (
            task.gym_id,
            f"float32 ({task.action_size},)",
            "; ".join(f"{low:g} to {high:g}" for low, high in ranges),
            task.default_objects or "cabinet",
            f"at most {task.max_steps}",
            task.goal or "none: touch is the metric",
        )
        rows.append((task.name, *cells))
    headings = ("Gymnasium id", "action", "workspace x; y; z (m)", "objects", "steps", "success")
    _print_table(f"Tasks of the protocol {PROTOCOL.name}", ("task", *headings), rows)


def doctor(workers: options.Workers = AUTO, as_json: options.AsJson = False) -> None:
    """Check the installation, the sandbox, and that this machine repeats its own bits."""
    from minitouch_bench.processes import core_count
    from minitouch_bench.verification.doctor import Check, CheckResult, examine

    count = worker_count(workers) or core_count()
    checks: list[Check] = []
    with notes().status("examining") as status:
        for check in examine(count):
            checks.append(check)
            status.update(f"{check.name}: {check.verdict}")
    failed = [check.name for check in checks if check.verdict is CheckResult.FAIL]
    if as_json:
        print(json.dumps({"healthy": not failed, "checks": [asdict(c) for c in checks]}, indent=1))
    else:
        rows = [(check.name, check.verdict, check.text) for check in checks]
        _print_table("This machine", ("Check", "Verdict", "What was found"), rows)
        answer, style = "This machine can be trusted with an evaluation.", "bold green"
        if failed:
            answer, style = f"Not to be trusted yet: {', '.join(failed)}", "bold red"
        data_console().print(f"\n{answer}", style=style)
    if failed:
        raise typer.Exit(CHECK_FAILED)


def _print_table(title: str, headings: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> None:
    """Print a table of words; the first column names its rows."""
    from minitouch_bench.reporting import tables

    columns = tables.make_columns(*headings[1:], words=headings)
    drawn = tuple(tables.make_row(*row) for row in rows)
    tables.show([tables.Table(title, headings[:1], columns, drawn)], data_console())
