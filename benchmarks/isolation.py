"""What the sandbox costs: a policy held in it against the same one in a plain process.

Both run in turn, episode by episode, so that what else the machine does weighs on both alike.
"""

import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.table import Table

from minitouch_bench.policies.policy import Isolation, IsolationOptions, zero_observation
from minitouch_bench.policies.policy_process import PolicyProcess
from minitouch_bench.policies.sources import parse_source
from tests.policies.recipes import run_recipes

LEVELS = (Isolation.PROCESS, Isolation.SANDBOX)
EPISODES = 20
ACTS = 50


def main() -> None:
    """Print the medians and their ratio for each format; files named are measured instead."""
    with tempfile.TemporaryDirectory() as directory:
        files = [Path(name) for name in sys.argv[1:]] or make_files(Path(directory))
        table = Table(title="Sandbox against process, medians", title_justify="left")
        for heading in ("policy", "reset, ms", "ratio", "act, ms", "ratio"):
            table.add_column(heading, justify="right" if heading != "policy" else "left")
        for source in ["zero", *map(str, files)]:
            resets, acts = measure(source)
            name = Path(source).suffix or source
            table.add_row(name, *cells(resets), *cells(acts))
        Console(width=90).print(table)


def make_files(directory: Path) -> Iterable[Path]:
    """Write the file of every recipe of docs/how-to/export-a-policy.md."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run_recipes(
            directory,
            "save_native(",
            "torch.export.save(",
            "torch.jit.trace(",
            "torch.onnx.export(",
            "stable_baselines3",
        )
    return sorted(directory.glob("policy.*"))


def measure(text: str) -> tuple[dict[Isolation, float], dict[Isolation, float]]:
    """Return the median seconds of a reset and of an act at each level."""
    source, observation = parse_source(text), zero_observation()
    policies = {
        level: PolicyProcess(source, IsolationOptions(level, trust=level is LEVELS[0]))
        for level in LEVELS
    }
    resets: dict[Isolation, list[float]] = {level: [] for level in LEVELS}
    acts: dict[Isolation, list[float]] = {level: [] for level in LEVELS}
    for episode in range(EPISODES + 1):
        for level in LEVELS[:: 1 if episode % 2 else -1]:
            policy = policies[level]
            begun = time.perf_counter()
            policy.reset(episode, "opening")
            if episode:  # the first one imports
                resets[level].append(time.perf_counter() - begun)
            for _ in range(ACTS):
                begun = time.perf_counter()
                policy.act(observation)
                acts[level].append(time.perf_counter() - begun)
    for policy in policies.values():
        policy.close()
    medians = [{level: statistics.median(one[level]) for level in LEVELS} for one in (resets, acts)]
    return medians[0], medians[1]


def cells(seconds: dict[Isolation, float]) -> tuple[str, str]:
    """Return both medians, and their ratio."""
    plain, held = (seconds[level] for level in LEVELS)
    return f"{plain * 1e3:.2f} → {held * 1e3:.2f}", f"{held / plain:.2f}"


if __name__ == "__main__":
    main()
