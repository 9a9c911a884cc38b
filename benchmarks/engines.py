"""What Ray costs: the same episodes by two local workers and by two on a Ray started here.

Both run in turn, so that what else the machine does weighs on both alike.
"""

import time

from rich.console import Console
from rich.table import Table

from benchmarks.throughput import measure, spread
from minitouch_bench.evaluation.engine import Engine, LocalEngine, open_engine
from minitouch_bench.evaluation.policy_setup import PolicySetup
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
    setup = PolicySetup(make_plan("smoke"), parse_source(POLICY))
    begun = time.perf_counter()
    with open_engine("ray", WORKERS) as ray:
        started = time.perf_counter() - begun
        engines: dict[str, Engine] = {"local": LocalEngine(WORKERS), "ray": ray}
        firsts: dict[str, list[float]] = {name: [] for name in engines}
        rates: dict[str, list[float]] = {name: [] for name in engines}
        for turn in range(ROUNDS):
            for name in list(engines)[:: 1 if turn % 2 else -1]:
                first, rate, _ = measure(engines[name], setup, specs)
                firsts[name].append(first)
                rates[name].append(rate)
        begun = time.perf_counter()
    ended = time.perf_counter() - begun
    show(firsts, rates)
    print(f"Ray itself: {started:.1f} s to start, {ended:.1f} s to end")


def show(firsts: dict[str, list[float]], rates: dict[str, list[float]]) -> None:
    """Print medians, with the lowest and highest."""
    table = Table(title=f"{WORKERS} workers, {ROUNDS} rounds, medians [lowest, highest]")
    for heading in ("engine", "first episode, s", "control steps/s"):
        table.add_column(heading, justify="right" if heading != "engine" else "left")
    for name, seconds in firsts.items():
        table.add_row(name, spread(seconds, ".1f"), spread(rates[name], ".0f"))
    ratios = [there / here for here, there in zip(rates["local"], rates["ray"], strict=True)]
    table.add_row("ray / local", "", spread(ratios, ".2f"))
    Console(width=90).print(table)


if __name__ == "__main__":
    main()
