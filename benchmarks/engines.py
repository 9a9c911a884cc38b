"""What Ray costs: the same episodes by two local workers and by two on a Ray started here.

Both run in turn, so that what else the machine does weighs on both alike.
"""

import statistics
import time
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from minitouch_bench.episode import EpisodeSpec
from minitouch_bench.evaluation.engine import Engine, open_engine
from minitouch_bench.evaluation.policy_setup import PolicySetup
from minitouch_bench.evaluation.rollout import LocalEngine
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.runs.plan import make_plan

WORKERS = 2
ROUNDS = 5
EPISODES = 30
TASKS = ("pushing", "opening")
POLICY = "random"


def main() -> None:
    """Print the times and rates of both, and the ratio of their rates round by round."""
    specs = make_plan("table4", TASKS, EPISODES // len(TASKS)).specs()
    begun = time.perf_counter()
    with open_engine("ray", WORKERS) as ray:
        started = time.perf_counter() - begun
        engines: dict[str, Engine] = {"local": LocalEngine(WORKERS), "ray": ray}
        firsts: dict[str, list[float]] = {name: [] for name in engines}
        rates: dict[str, list[float]] = {name: [] for name in engines}
        for turn in range(ROUNDS):
            for name in list(engines)[:: 1 if turn % 2 else -1]:
                first, rate = measure(engines[name], specs)
                firsts[name].append(first)
                rates[name].append(rate)
        begun = time.perf_counter()
    ended = time.perf_counter() - begun
    show(firsts, rates)
    print(f"Ray itself: {started:.1f} s to start, {ended:.1f} s to end")


def measure(engine: Engine, specs: Sequence[EpisodeSpec]) -> tuple[float, float]:
    """Return the seconds to the first episode's end, and the control steps a second after it."""
    begun = time.perf_counter()
    steps, first = 0, 0.0
    for record in engine.run(PolicySetup(make_plan("smoke"), parse_source(POLICY)), specs):
        if not first:
            first = time.perf_counter() - begun
        else:
            steps += len(record.trace.actions)
    return first, steps / (time.perf_counter() - begun - first)


def show(firsts: dict[str, list[float]], rates: dict[str, list[float]]) -> None:
    """Print medians, with the lowest and highest."""
    table = Table(title=f"{WORKERS} workers, {ROUNDS} rounds, medians [lowest, highest]")
    for heading in ("engine", "first episode, s", "control steps/s"):
        table.add_column(heading, justify="right" if heading != "engine" else "left")
    for name, seconds in firsts.items():
        table.add_row(name, cell(seconds, 1), cell(rates[name], 0))
    ratios = [there / here for here, there in zip(rates["local"], rates["ray"], strict=True)]
    table.add_row("ray / local", "", cell(ratios, 2))
    Console(width=90).print(table)


def cell(values: Sequence[float], digits: int) -> str:
    """Return a median with its range."""
    low, high = min(values), max(values)
    return f"{statistics.median(values):.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


if __name__ == "__main__":
    main()
