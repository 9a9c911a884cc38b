"""One metric of one task, looked at after every episode until its answer is certain.

The evidence may be looked at as often as one likes. An e-process is the wealth of a gambler who
bets against a hypothesis at fair odds: if the hypothesis holds, the chance that the wealth ever
reaches 1 / alpha is at most alpha. Evidence is the logarithm of such wealth.

Source: I. Waudby-Smith and A. Ramdas, "Estimating means of bounded random variables by
betting", J. R. Stat. Soc. B 86 (2024); J. Ville, "Étude critique de la notion de collectif"
(1939).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.metrics.intervals import Root, stream
from minitouch_bench.records import Estimate
from minitouch_bench.regression.differences import (
    ALPHA,
    Discordance,
    count_discordance,
    last_true,
    paired_mean,
    tango,
)
from minitouch_bench.regression.gate import Decision, JudgedMetric
from minitouch_bench.regression.paired_tests import (
    WORSE_SIGNS,
    is_binary,
    measure_effect,
)
from minitouch_bench.regression.pairing import EpisodePair, PairedValues
from minitouch_bench.regression.power import FEWEST_FOR_A_MEAN
from minitouch_bench.regression.settings import GateSettings

EARLY_PART = 2.0 / 3.0
"""Part of the level that is for early regressions."""

LOOKS = (0.5, 0.75)
"""Parts of a task's episodes after which a mean is looked at for a pass."""

BETTING = "betting confidence sequence"

BETS = np.array([0.25, 0.5, 0.75, 0.95])
"""Parts of the largest bet that cannot ruin; the wealth is spread evenly over them."""


@dataclass(frozen=True)
class AlphaParts:
    """Chances of a false answer, which ``tests`` metrics of tasks share.

    Of a regression: ``early``, and ``final`` for judging a whole run. Of an early pass of one
    metric: ``passing``; a pass needs them all, so nothing is shared.
    """

    early: float
    final: float
    passing: float
    tests: int

    @classmethod
    def of(cls, alpha: float, tests: int) -> "AlphaParts":
        """Split the gate's level."""
        early = EARLY_PART * alpha
        return cls(early, alpha - early, alpha / 2.0, tests)


class MetricWatch:
    """Watches one metric; once decided it stays so: that is what the levels are for.

    A mean over tasks counts in whole rounds, one episode of each task: only then are the tasks
    in balance, on which the evidence of its pass rests.
    """

    def __init__(
        self, baseline: PairedValues, settings: GateSettings, alpha: AlphaParts, root: Root
    ) -> None:
        self.decision, self.reason = Decision.OPEN, ""
        self._baseline = baseline
        self._alpha = alpha
        self._root = root
        self._name = f"{baseline.task} {baseline.metric}"
        tolerance = settings.tolerance(baseline.task, baseline.metric)
        self._allowed = tolerance.absolute(float(baseline.first.mean()))
        self._is_binary = is_binary(baseline.metric)
        self._round: dict[str, EpisodePair] = {}
        self._seen = PairedValues(baseline.task, baseline.metric, baseline.tasks)
        self._highest_evidence = 0.0

    @property
    def count(self) -> int:
        """Number of episodes that have counted."""
        return len(self._seen.first)

    def add(self, pair: EpisodePair) -> None:
        """Count a pair if it is of this metric's tasks, and look."""
        if pair.first.task not in self._seen.tasks:
            return
        self._round[pair.first.task] = pair
        if len(self._round) == len(self._seen.tasks):
            self._seen = self._seen.with_pairs(tuple(self._round.values()))
            self._round.clear()
            if self.decision is Decision.OPEN:
                self._look()

    def judged(self) -> JudgedMetric:
        """Return the effect over the episodes seen; p and a share's interval hold at any stop."""
        effect = measure_effect(self._seen, self._root)
        if self._is_binary:
            worsening = share_sequence(self._discordance, ALPHA)
            low, high = -worsening.high, -worsening.low
            difference = replace(worsening, value=-worsening.value, low=low, high=high)
            effect = replace(effect, difference=difference)
        p_value = min(1.0, self._alpha.tests * math.exp(-self._highest_evidence))
        return JudgedMetric(replace(effect, p_value=p_value), p_value, self._allowed, self.decision)

    @property
    def _discordance(self) -> Discordance:
        return count_discordance(self._seen.first, self._seen.second)

    @property
    def _worsenings(self) -> NDArray[np.float64]:
        return self._seen.differences * WORSE_SIGNS[self._seen.direction]

    def _look(self) -> None:
        evidence = self._evidence()
        self._highest_evidence = max(self._highest_evidence, evidence)
        is_beyond = float(self._worsenings.mean()) > self._allowed
        if evidence >= math.log(self._alpha.tests / self._alpha.early) and is_beyond:
            self.decision = Decision.REGRESSION
            self.reason = f"{self._name} is worse beyond its tolerance"
        elif self._is_binary:
            self._look_ahead()
        if self.decision is Decision.OPEN and self._is_within():
            self.decision = Decision.PASSED

    def _evidence(self) -> float:
        if self._is_binary:
            return evidence_of_loss(self._discordance)
        return evidence_of_worsening(self._worsenings)

    def _is_within(self) -> bool:
        """Tell whether a worsening beyond the tolerance is excluded."""
        if self._is_binary:
            evidence = evidence_of_no_loss(self._discordance, self._allowed)
            return evidence >= math.log(1.0 / self._alpha.passing)
        looks = [math.ceil(part * len(self._baseline.first)) for part in LOOKS]
        if self.count not in looks or self.count < FEWEST_FOR_A_MEAN:
            return False
        rng = stream(self._root, self._seen.task, self._seen.metric, f"look at {self.count}")
        alpha = 2.0 * self._alpha.passing / len(LOOKS)
        return paired_mean(self._worsenings, rng, alpha=alpha).estimate.high <= self._allowed

    def _look_ahead(self) -> None:
        """Decide if the whole run will be judged alike, however its last episodes end.

        The baseline's outcomes are known: where it failed the candidate can only win, where
        it succeeded only lose.
        """
        found, planned = self._discordance, len(self._baseline.first)
        left_to_lose = int(self._baseline.first.sum() - self._seen.first.sum())
        left_to_win = planned - self.count - left_to_lose
        best = Discordance(planned, found.lost, found.won + left_to_win)
        level = self._alpha.final / self._alpha.tests
        if -best.difference > self._allowed and best.p_value <= level:
            self.decision = Decision.REGRESSION
            self.reason = f"{self._name} stays worse beyond its tolerance however the rest ends"
        worst = Discordance(planned, found.lost + left_to_lose, found.won)
        if -worst.difference <= self._allowed and -tango(worst).low <= self._allowed:
            self.decision = Decision.PASSED


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
    low, high = _least_worsening(found, wanted), -_least_worsening(found.mirrored, wanted)
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
