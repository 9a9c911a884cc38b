"""Exact probabilities of the binomial distribution, and the sign test that rests on them."""

from functools import cache

import numpy as np
from numpy.typing import NDArray


def binomial_pmf(n: int, share: float) -> NDArray[np.float64]:
    """Return the probabilities of 0 to n successes in n draws, float64 (n + 1,)."""
    counts = np.arange(n + 1)
    if share in (0.0, 1.0):
        return np.where(counts == share * n, 1.0, 0.0)
    logs = _log_factorials(int(n).bit_length())[: n + 1]
    exponents = logs[n] - logs - logs[::-1]
    exponents += counts * np.log(share) + (n - counts) * np.log1p(-share)
    pmf: NDArray[np.float64] = np.exp(exponents)
    return pmf


def mcnemar_p(lost: int, won: int) -> float:
    """Return the two-sided p-value of the exact McNemar test.

    ``lost`` and ``won`` count the pairs of which only the first, only the second succeeds.
    Given their number, each is as likely as the other where the policies are equally good.
    Without such a pair the value is 1.

    Source: Q. McNemar, "Note on the sampling error of the difference between correlated
    proportions or percentages", Psychometrika 12 (1947), with exact binomial tails.
    """
    tail = float(binomial_pmf(lost + won, 0.5)[: min(lost, won) + 1].sum())
    return min(1.0, 2.0 * tail)


@cache
def critical_count(pairs: int, alpha: float) -> int:
    """Return the least count on one side that makes ``mcnemar_p`` <= alpha.

    It is ``pairs`` + 1 where no count does.
    """
    p_values = 2.0 * np.cumsum(binomial_pmf(pairs, 0.5))
    return pairs + 1 - int(np.searchsorted(p_values, alpha, side="right"))


@cache
def _log_factorials(bits: int) -> NDArray[np.float64]:
    """Return log 0! to log (2^bits - 1)!, float64 (2^bits,)."""
    return np.concatenate(([0.0], np.cumsum(np.log(np.arange(1, 2**bits)))))
