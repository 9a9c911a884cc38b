"""Progress where there is no terminal."""

import io

import numpy as np
from rich.console import Console

from minitouch_bench.cli.progress import EpisodeProgress
from minitouch_bench.records import EpisodeSpec, Role
from tests.reporting.synthetic import make_record

SPEC = EpisodeSpec(Role.FINAL, "pushing", 0, 1, 0, "cube")


def test_without_a_terminal_there_is_one_line_per_minute():
    now = [0.0]
    console = Console(file=io.StringIO(), width=200)
    with EpisodeProgress(console, clock=lambda: now[0]) as progress:
        progress.callbacks.phase("episodes", 20)
        for second in range(0, 200, 10):
            now[0] = float(second)
            progress.callbacks.episode(make_record(np.random.default_rng(1), SPEC, 1.0))
        lines = console.file.getvalue().splitlines()
    assert [line.split("  ")[0].strip() for line in lines] == [
        "episodes: 7 of 20", "episodes: 13 of 20", "episodes: 19 of 20",
    ]  # fmt: skip
