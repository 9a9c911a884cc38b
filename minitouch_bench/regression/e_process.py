"""Evidence that may be looked at after every episode, as often as one likes.

An e-process is the wealth of a gambler who bets against a hypothesis at fair odds: if the
hypothesis holds, the chance that the wealth ever reaches 1 / alpha is at most alpha. All
values here are logarithms of such wealth.

Source: I. Waudby-Smith and A. Ramdas, "Estimating means of bounded random variables by
betting", J. R. Stat. Soc. B 86 (2024); J. Ville, "Étude critique de la notion de collectif"
(1939).
"""

import math

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.records import Estimate
from minitouch_bench.regression.differences import Discordance, last_true

BETTING = "betting confidence sequence"

BETS = np.array([0.25, 0.5, 0.75, 0.95])
"""Parts of the largest bet that cannot ruin; the wealth is spread evenly over them."""


def evidence_of_loss(found: Discordance, margin: float = 0.0) -> float:
    """Return the log evidence that the share has worsened by more than ``margin``."""
    stakes = BETS / (1.0 + margin)
    return _wealth(found, np.log1p(stakes * (1 - margin)), np.log1p(-stakes * (1 + margin)),
                   np.log1p(-stakes * margin))  # fmt: skip


def evidence_of_no_loss(found: Discordance, margin: float) -> float:
    """Return the log evidence that the share has worsened by less than ``margin``."""
    stakes = BETS / (1.0 - margin)
    return _wealth(found, np.log1p(-stakes * (1 - margin)), np.log1p(stakes * (1 + margin)),
                   np.log1p(stakes * margin))  # fmt: skip


def evidence_of_worsening(worsenings: NDArray[np.float64]) -> float:
    """Return the log evidence that worsenings, float64 (N,) in order, are not a coin's.

    The hypothesis: policies that are equal, so that each worsening is as likely as the
    improvement of the same size. A bet on the sign is scaled by the size, over the root mean
    square of the sizes before it that are not 0.
    """
    squares = np.cumsum(worsenings**2)
    counts = np.cumsum(worsenings != 0.0)
    scales = np.sqrt(np.divide(squares, counts, out=np.zeros_like(squares), where=counts > 0))
    before = np.concatenate(([0.0], scales[:-1]))
    sizes = np.divide(np.abs(worsenings), before, out=np.ones_like(squares), where=before > 0.0)
    gains = np.sign(worsenings) * np.minimum(sizes, 1.0)
    return _log_mean_exp(np.log1p(np.outer(BETS, gains)).sum(axis=1))


def share_sequence(found: Discordance, alpha: float) -> Estimate:
    """Estimate a share's worsening by an interval that holds at every look, with 1 - alpha."""
    wanted = math.log(2.0 / alpha)
    mirrored = Discordance(found.n, lost=found.won, won=found.lost)
    low, high = _least_worsening(found, wanted), -_least_worsening(mirrored, wanted)
    return Estimate(-found.difference, low, high, found.n, BETTING)


def _wealth(
    found: Discordance,
    on_lost: NDArray[np.float64],
    on_won: NDArray[np.float64],
    on_same: NDArray[np.float64],
) -> float:
    same = found.n - found.lost - found.won
    return _log_mean_exp(found.lost * on_lost + found.won * on_won + same * on_same)


def _log_mean_exp(values: NDArray[np.float64]) -> float:
    highest = float(values.max())
    return highest + math.log(float(np.exp(values - highest).mean()))


def _least_worsening(found: Discordance, wanted: float) -> float:
    """Return the largest margin that the evidence of a loss exceeds, -1 if it exceeds none."""

    def is_exceeded(margin: float) -> bool:
        return evidence_of_loss(found, margin) >= wanted

    return last_true(is_exceeded, -1.0, 1.0, halvings=40)
