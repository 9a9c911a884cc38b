"""How often the leaderboard's tests err: 2,000 simulated boards per setting.

A board has four rows in one task, which play the same 100 episodes. Where all four have the same
true mean, each pair with a significant difference is a false alarm. Power: the share of boards on
which a row that is better by 0.15 than the next is ranked before it.

    python -m benchmarks.board_errors [--boards 2000]
"""

import argparse
from collections.abc import Callable, Mapping

import numpy as np
import scipy
from numpy.typing import NDArray

from minitouch_bench.leaderboard.ranking import judge_pairs, ranks_of, share_p_values
from minitouch_bench.metrics.intervals import mean_differences
from minitouch_bench.metrics.statistics import ALPHA

Floats = NDArray[np.float64]
Method = Callable[[np.random.Generator, float], Floats]
"""Draws the true success of each training seed of a method, moved by a difference."""

EPISODES = 100
SHARED = 0.5
"""Share of an episode's variance that is its own difficulty, the same for every policy."""
BETTER = 0.15
FAILED, LEARNED, FAILS = 0.02, 0.85, 0.2
"""Success of a seed that fails and of one that learns, and how often a seed fails."""
MIXED = FAILS * FAILED + (1 - FAILS) * LEARNED


def varying(seeds: int, deviation: float, mean: float = 0.5) -> Method:
    """Return a method whose seeds vary normally."""
    return lambda rng, more: np.clip(rng.normal(mean + more, deviation, seeds), 0.001, 0.999)


def failing(seeds: int) -> Method:
    """Return a method of which some seeds fail; a better one is better where it learns."""
    return lambda rng, more: np.where(rng.random(seeds) < FAILS, FAILED, min(LEARNED + more, 0.999))


SETTINGS: Mapping[str, tuple[Method, ...]] = {
    "equal variances, 5 seeds": (varying(5, 0.1),) * 4,
    "equal variances, 8 seeds": (varying(8, 0.1),) * 4,
    "unequal variances, 5 seeds": tuple(varying(5, sd) for sd in (0.02, 0.05, 0.1, 0.2)),
    "seeds do not vary, 5 seeds": (varying(5, 0.0),) * 4,
    "seeds of all fail in 0.2, 5 seeds": (failing(5),) * 4,
    "seeds of all fail in 0.2, 8 seeds": (failing(8),) * 4,
    "3, 5, 8 and 10 seeds": tuple(varying(seeds, 0.1) for seeds in (3, 5, 8, 10)),
    "one seed": (varying(1, 0.0),) * 4,
    "one seed beside 5": (varying(1, 0.0), *(varying(5, 0.1),) * 3),
    "only one method fails in 0.2, 5 seeds": (failing(5), *(varying(5, 0.02, MIXED),) * 3),
}


def play(rng: np.random.Generator, success: Floats, ease: Floats) -> Floats:
    """Return the outcomes of seeds of a true success, (S, E), on episodes of a shared ease (E,)."""
    own = rng.standard_normal((len(success), len(ease)))
    latent = np.sqrt(SHARED) * ease + np.sqrt(1 - SHARED) * own
    won: Floats = (latent < scipy.stats.norm.ppf(success)[:, None]).astype(np.float64)
    return won


def simulate(methods: tuple[Method, ...], boards: int, better: float) -> tuple[float, float, float]:
    """Return the shares of significant pairs, of boards with one, and with the first row ahead."""
    rng = np.random.default_rng(0)
    pairs = np.triu_indices(len(methods), 1)
    apart, boards_apart, ahead = 0.0, 0, 0
    for _ in range(boards):
        ease = rng.standard_normal(EPISODES)
        rows = [
            play(rng, method(rng, better if index == 0 else 0.0), ease)
            for index, method in enumerate(methods)
        ]
        p_values = share_p_values(rows, mean_differences([rows]))
        _, better_rows = judge_pairs(np.array([row.mean() for row in rows]), p_values)
        ranks = ranks_of(better_rows)
        apart += float(np.mean(p_values[pairs] <= ALPHA))
        boards_apart += any(rank.best > 1 for rank in ranks)
        ahead += ranks[1].best > ranks[0].best
    return apart / boards, boards_apart / boards, ahead / boards


def main() -> None:
    """Print a row per setting."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--boards", type=int, default=2000)
    boards = parser.parse_args().boards
    print("| Setting | Significant pairs at 5 % | Boards with a false rank | Power |")
    print("|---|---|---|---|")
    for name, methods in SETTINGS.items():
        pair, board, _ = simulate(methods, boards, 0.0)
        _, _, ahead = simulate(methods, boards, BETTER)
        print(f"| {name} | {pair:.1%} | {board:.1%} | {ahead:.1%} |", flush=True)


if __name__ == "__main__":
    main()
