"""The command ``doctor``: what this machine can do."""

import json
from dataclasses import asdict

import typer

from minitouch_bench.cli import options
from minitouch_bench.cli.console import data_console, notes
from minitouch_bench.errors import CHECK_FAILED
from minitouch_bench.evaluation.engine import AUTO, worker_count


def doctor(workers: options.Workers = AUTO, as_json: options.AsJson = False) -> None:
    """Check the installation, the sandbox, and that this machine repeats its own bits."""
    from minitouch_bench.processes import core_count
    from minitouch_bench.reporting.tables import Table, make_columns, make_row, show
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
        console, columns = data_console(), ("Verdict", "What was found")
        rows = tuple(make_row(check.name, check.verdict, check.text) for check in checks)
        made = make_columns(*columns, words=columns)
        show([Table("This machine", ("Check",), made, rows)], console)
        if failed:
            console.print(f"\nNot to be trusted yet: {', '.join(failed)}", style="bold red")
        else:
            console.print("\nThis machine can be trusted with an evaluation.", style="bold green")
    if failed:
        raise typer.Exit(CHECK_FAILED)
