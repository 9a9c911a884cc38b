"""Compare runs of the same episodes, each against the first."""

from dataclasses import dataclass
from pathlib import Path

from minitouch_bench.files import write_file
from minitouch_bench.regression.comparison import Comparison, compare_runs
from minitouch_bench.regression.documents import comparison_json
from minitouch_bench.regression.markdown import comparison_markdown
from minitouch_bench.reporting import read_run


@dataclass(frozen=True)
class CompareOptions:
    """Which runs to compare; ``output`` gets comparison.md and comparison.json."""

    runs: tuple[Path, ...]
    output: Path | None = None


def compare(options: CompareOptions) -> Comparison:
    """Compare runs, and write the pages asked for.

    Raises:
        UsageError: the runs are too few or too many, or not of the same episodes.
        RunDirectoryError: one is no run, or a page cannot be written.
    """
    comparison = compare_runs([read_run(run) for run in options.runs], list(map(str, options.runs)))
    if options.output is not None:
        write_file(options.output / "comparison.json", comparison_json(comparison))
        write_file(options.output / "comparison.md", comparison_markdown(comparison))
    return comparison
