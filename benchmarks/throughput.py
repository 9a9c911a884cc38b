"""What isolation costs a whole run: the same episodes with the policy in a sandbox and out of it.

The levels take turns, so that what else the machine does weighs on all alike; each round gives
one ratio. The bits must be the same at every level, and are compared.
"""

import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from minitouch_bench.episode import EpisodeSpec
from minitouch_bench.evaluation.engine import Engine, LocalEngine
from minitouch_bench.evaluation.policy_setup import PolicySetup
from minitouch_bench.policies.native import save_native
from minitouch_bench.policies.networks import TouchActor
from minitouch_bench.policies.policy import Isolation, IsolationOptions
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.runs.plan import make_plan

LEVELS = (Isolation.PROCESS, Isolation.SANDBOX, Isolation.NONE)
ROUNDS = 7
EPISODES = 3
WORKERS = 2


def main() -> None:
    """Print the rate at each level and the ratios to a plain process, round by round."""
    specs = make_plan("smoke", episodes=EPISODES).specs()
    rates: dict[Isolation, list[float]] = {level: [] for level in LEVELS}
    with tempfile.TemporaryDirectory() as folder:
        save_native(TouchActor(action_size=5), Path(folder) / "policy.safetensors")
        source = parse_source(f"{folder}/policy.safetensors")
        found = set()
        for turn in range(ROUNDS):
            for level in LEVELS[turn % 3 :] + LEVELS[: turn % 3]:
                isolation = IsolationOptions(level, trust=True)
                setup = PolicySetup(make_plan("smoke"), source, None, isolation)
                _, rate, digests = measure(LocalEngine(WORKERS), setup, specs)
                rates[level].append(rate)
                found.add(digests)
    assert len(found) == 1, "the levels gave different bits"
    show(rates)


def measure(
    engine: Engine, setup: PolicySetup, specs: Sequence[EpisodeSpec]
) -> tuple[float, float, tuple[str, ...]]:
    """Return the seconds to the first episode's end, the control steps a second after it, digests.

    The digests are in the order of ``specs``.
    """
    digests, steps, first, begun = {}, 0, 0.0, time.perf_counter()
    for record in engine.run(setup, specs):
        digests[record.spec.key] = record.trace.digest()
        if first:
            steps += len(record.trace.actions)
        else:
            first = time.perf_counter() - begun
    rate = steps / (time.perf_counter() - begun - first)
    return first, rate, tuple(digests[spec.key] for spec in specs)


def show(rates: dict[Isolation, list[float]]) -> None:
    """Print a row a level: median, lowest and highest."""
    title = f"{WORKERS} workers, {ROUNDS} rounds in turn: median [lowest, highest]"
    table = Table(title=title, title_justify="left")
    for heading in ("isolation", "control steps/s", "ratio to process"):
        table.add_column(heading)
    plain = rates[Isolation.PROCESS]
    for level in LEVELS:
        ratios = [one / other for one, other in zip(rates[level], plain, strict=True)]
        table.add_row(level, spread(rates[level], ".0f"), spread(ratios, ".3f"))
    Console(width=90).print(table)


def spread(values: Sequence[float], form: str) -> str:
    """Return the median with the lowest and the highest."""
    low, middle, high = min(values), statistics.median(values), max(values)
    return f"{middle:{form}} [{low:{form}}, {high:{form}}]"


if __name__ == "__main__":
    main()
