"""``report.md``: the tables and facts of a report in GitHub's Markdown."""

from minitouch_bench.rendering.markdown import code_span, escape, table_lines
from minitouch_bench.reporting.labels import RunSection, fault_lines
from minitouch_bench.reporting.report import Report


def to_markdown(report: Report) -> str:
    """Write a report as Markdown."""
    parts = [f"# {escape(report.title)}", ""]
    for section in report.sections:
        parts += _headline(section)
    for table in (
        report.table4,
        *report.tables_over_runs,
        *report.novel_shapes,
        report.diagnostics,
    ):
        parts += ["", f"## {table.title}", "", *table_lines(table), ""]
        parts += [f"- {escape(note)}" for note in table.notes]
    if any(section.faults for section in report.sections):
        parts += ["", "## Policy faults", ""]
        for section in report.sections:
            parts += [f"- {escape(line)}" for line in fault_lines(section)]
    parts += ["", "## What was run"]
    for section in report.sections:
        parts += ["", *_facts(section)]
    if report.videos:
        parts += ["", "## Videos", ""]
        parts += [f"- [{escape(video.caption)}](<{video.address}>)" for video in report.videos]
    return "\n".join(parts) + "\n"


def _headline(section: RunSection) -> list[str]:
    """Say what a run is, and its labels."""
    header = section.run.header
    kind = "official" if header.official else "unofficial"
    lines = [
        f"**{escape(section.name)}**: suite {escape(header.suite)}, {kind}, "
        f"protocol {escape(header.protocol)} ({code_span(header.protocol_digest[:12])})"
    ]
    lines += [f"> {escape(label)}" for label in section.labels]
    return [lines[0], "", *(f"{line}  " for line in lines[1:]), ""]


def _facts(section: RunSection) -> list[str]:
    """List what was run and on what, and the command that repeats it."""
    header, environment = section.run.header, section.run.environment
    packages = ", ".join(f"{name} {version}" for name, version in environment.packages.items())
    machine = ", ".join(f"{key}: {value}" for key, value in environment.machine.items())
    policy = header.policy
    episodes = section.episodes if header.chosen else f"{header.episodes} episodes a task"
    facts = {
        "Policy": f"{escape(policy.name)} ({escape(policy.kind)}), {code_span(policy.source)}",
        "Policy digest": code_span(policy.digest) if policy.digest else "built in",
        "Protocol": f"{escape(header.protocol)}, {code_span(header.protocol_digest)}",
        "Suite": f"{escape(header.suite)}, seed {header.seed}, {episodes}",
        "Isolation": f"{escape(header.isolation)}, {header.act_timeout_s:g} s an action",
        "Packages": escape(packages),
        "Machine": escape(machine),
        "Started": f"{escape(environment.started)}, {environment.wall_s:.0f} s, "
        f"{environment.workers} workers",
        "Repeat it": code_span(section.command),
    }
    return [f"**{escape(section.name)}**", "", *(f"- {k}: {v}" for k, v in facts.items() if v)]
