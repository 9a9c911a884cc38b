"""Reports of runs: tables and plots as data, and one writer a format."""

from minitouch_bench.reporting.report import Report, build_report, table4_latex
from minitouch_bench.reporting.run_directory import (
    derived_files,
    read_run,
    write_report,
    write_run,
)
from minitouch_bench.reporting.terminal import show_report

__all__ = [
    "Report",
    "build_report",
    "derived_files",
    "read_run",
    "show_report",
    "table4_latex",
    "write_report",
    "write_run",
]
