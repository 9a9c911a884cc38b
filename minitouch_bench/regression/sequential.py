"""The gate that looks after every episode, and stops as soon as its answer is certain.

A part of the gate's level is for stopping early, the rest for judging a run that was played to
its end, so that together a false answer keeps the level:

- a regression is certain by an e-process (Bonferroni over all metrics and tasks), or because
  no outcome of the remaining episodes could change what the whole run will be judged to be;
- no regression is certain once every metric of every task is within its tolerance: a share by
  an e-process or by what remains, a mean by its interval at one of LOOKS.

Episodes count in one fixed order, whatever the order they end in: the answer does not depend
on the number of workers.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.metrics.streams import Root, stream
from minitouch_bench.records import EpisodeMetrics, Estimate, Role
from minitouch_bench.regression.effects import measure_effect, worse_sign
from minitouch_bench.regression.evidence import (
    evidence_of_loss,
    evidence_of_no_loss,
    evidence_of_worsening,
    share_sequence,
)
from minitouch_bench.regression.gate import Judgement, Ruling, guarded_samples, overall
from minitouch_bench.regression.means import ALPHA, paired_mean
from minitouch_bench.regression.pairing import (
    SHARE_METRICS,
    EpisodePair,
    Sample,
    episode_key,
    refuse_other_episode,
    value_of,
)
from minitouch_bench.regression.power import FEWEST_FOR_A_MEAN
from minitouch_bench.regression.shares import Discordance, count_discordance, tango
from minitouch_bench.regression.tolerances import GateSettings

EARLY_PART = 2.0 / 3.0
"""Part of the level that is for early regressions."""

LOOKS = (0.5, 0.75)
"""Parts of a task's episodes after which a mean is looked at for a pass."""


def play_order(episodes: Sequence[EpisodeMetrics], root: Root) -> tuple[EpisodeMetrics, ...]:
    """Return the episodes so that tasks take turns, each task's own in a random order.

    The order is random so that no part of a suite, such as its held-out shapes, comes first;
    it is a function of ``root`` alone.
    """
    queues = []
    for task in dict.fromkeys(episode.task for episode in episodes):
        own = [episode for episode in episodes if episode.task == task]
        turns = stream(root, task, "order").permutation(len(own))
        queues.append([own[turn] for turn in turns])
    longest = max(len(queue) for queue in queues)
    return tuple(queue[turn] for turn in range(longest) for queue in queues if turn < len(queue))


@dataclass(frozen=True)
class Levels:
    """Chances of a false answer, which ``tests`` metrics of tasks share.

    Of a regression: ``early``, and ``final`` by the judgement of a whole run. Of an early pass
    of one metric: ``passing``; a pass needs them all, so nothing is shared.
    """

    early: float
    final: float
    passing: float
    tests: int

    @classmethod
    def of(cls, settings: GateSettings, tests: int) -> "Levels":
        """Split the gate's level."""
        early = EARLY_PART * settings.alpha
        return cls(early, settings.alpha - early, settings.alpha / 2.0, tests)


class SequentialGate:
    """Takes a candidate's episodes as they end, and says when to stop.

    ``order``: the baseline's episodes as ``play_order`` has them; ``root`` seeds the bootstrap.

    Errors: UsageError if the episodes have none of the metrics that the settings guard.
    """

    def __init__(self, order: Sequence[EpisodeMetrics], settings: GateSettings, root: Root) -> None:
        self._order = tuple(order)
        self.settings = settings
        self._waiting: dict[str, EpisodeMetrics] = {}
        self._pairs: list[EpisodePair] = []
        mirror = [EpisodePair(Role.FINAL, episode, episode) for episode in order]
        tasks = tuple(dict.fromkeys(episode.task for episode in order))
        samples = guarded_samples(mirror, tasks, settings)
        self.levels = Levels.of(settings, len(samples))
        self._cells = [_Cell(sample, settings, self.levels, root) for sample in samples]

    @property
    def used(self) -> int:
        """Number of episodes the answer rests on."""
        return len(self._pairs)

    @property
    def planned(self) -> int:
        """Number of episodes of the whole run."""
        return len(self._order)

    @property
    def pairs(self) -> tuple[EpisodePair, ...]:
        """The episodes the answer rests on, in the order they count in."""
        return tuple(self._pairs)

    @property
    def ruling(self) -> Ruling:
        """The answer; OPEN while it is not certain."""
        found = overall([cell.ruling for cell in self._cells])
        return Ruling.OPEN if found is Ruling.INCONCLUSIVE else found

    @property
    def is_certain(self) -> bool:
        """Whether there is an answer."""
        return self.ruling is not Ruling.OPEN

    @property
    def reason(self) -> str:
        """Why the answer is certain, in words."""
        return next(
            (cell.reason for cell in self._cells if cell.ruling is Ruling.REGRESSION),
            "every metric is within its tolerance",
        )

    def add(self, episodes: Iterable[EpisodeMetrics]) -> bool:
        """Take episodes in any order; return whether the answer is certain.

        Errors: UsageError if one is not the baseline's episode of its name.
        """
        for episode in episodes:
            self._waiting[episode_key(Role.FINAL, episode)] = episode
        while not self.is_certain and self.used < self.planned:
            own = self._order[self.used]
            other = self._waiting.pop(episode_key(Role.FINAL, own), None)
            if other is None:
                break
            self._count(EpisodePair(Role.FINAL, own, other))
        return self.is_certain

    def judgements(self) -> tuple[Judgement, ...]:
        """Return what is known of each metric that has an episode, at an early stop."""
        return tuple(cell.judgement() for cell in self._cells if cell.count)

    def _count(self, pair: EpisodePair) -> None:
        refuse_other_episode(pair)
        self._pairs.append(pair)
        for cell in self._cells:
            if cell.task == pair.first.task:
                cell.add(pair)


class _Cell:
    """One metric of one task. Once decided it stays so: that is what the levels are for."""

    def __init__(
        self, baseline: Sample, settings: GateSettings, levels: Levels, root: Root
    ) -> None:
        self.task, self.metric = baseline.task, baseline.metric
        self.ruling, self.reason = Ruling.OPEN, ""
        self._levels = levels
        self._root = root
        self._planned = len(baseline.first)
        self._successes = int(baseline.first.sum())
        mean = float(baseline.first.mean())
        self._allowed = settings.tolerance(self.task, self.metric).absolute(mean)
        self._first: list[float] = []
        self._second: list[float] = []
        self._highest_evidence = 0.0

    @property
    def count(self) -> int:
        return len(self._first)

    def add(self, pair: EpisodePair) -> None:
        self._first.append(value_of(pair.first, self.metric))
        self._second.append(value_of(pair.second, self.metric))
        if self.ruling is Ruling.OPEN:
            self._look()

    def judgement(self) -> Judgement:
        """Return the effect over the episodes seen; p and a share's interval hold at any stop."""
        sample = Sample(self.task, self.metric, np.array(self._first), np.array(self._second))
        effect = measure_effect(sample, self._root)
        if self.metric in SHARE_METRICS:
            sequence = share_sequence(self._discordance, ALPHA)
            effect = replace(effect, difference=_as_difference(sequence))
        p_value = min(1.0, self._levels.tests * math.exp(-self._highest_evidence))
        return Judgement(replace(effect, p_value=p_value), p_value, self._allowed, self.ruling)

    @property
    def _worsenings(self) -> NDArray[np.float64]:
        differences: NDArray[np.float64] = np.array(self._second) - np.array(self._first)
        return differences * worse_sign(self.metric)

    @property
    def _discordance(self) -> Discordance:
        return count_discordance(np.array(self._first), np.array(self._second))

    def _look(self) -> None:
        wanted = math.log(self._levels.tests / self._levels.early)
        evidence = self._evidence()
        self._highest_evidence = max(self._highest_evidence, evidence)
        is_beyond = float(self._worsenings.mean()) > self._allowed
        name = f"{self.task} {self.metric}"
        if evidence >= wanted and is_beyond:
            self.ruling = Ruling.REGRESSION
            self.reason = f"{name} is worse beyond its tolerance"
        elif self.metric in SHARE_METRICS:
            self._look_ahead(name)
        if self.ruling is Ruling.OPEN and self._is_within():
            self.ruling = Ruling.PASSED

    def _evidence(self) -> float:
        if self.metric in SHARE_METRICS:
            return evidence_of_loss(self._discordance)
        return evidence_of_worsening(self._worsenings)

    def _is_within(self) -> bool:
        """Tell whether a worsening beyond the tolerance is excluded."""
        if self.metric in SHARE_METRICS:
            evidence = evidence_of_no_loss(self._discordance, self._allowed)
            return evidence >= math.log(1.0 / self._levels.passing)
        looks = [math.ceil(part * self._planned) for part in LOOKS]
        if self.count not in looks or self.count < FEWEST_FOR_A_MEAN:
            return False
        rng = stream(self._root, self.task, self.metric, f"look at {self.count}")
        alpha = 2.0 * self._levels.passing / len(LOOKS)
        return paired_mean(self._worsenings, rng, alpha=alpha).estimate.high <= self._allowed

    def _look_ahead(self, name: str) -> None:
        """Decide if the whole run will be judged alike, however its last episodes end.

        The baseline's outcomes are known: where it failed the candidate can only win, where
        it succeeded only lose.
        """
        found, planned = self._discordance, self._planned
        left_to_lose = self._successes - int(sum(self._first))
        left_to_win = planned - self.count - left_to_lose
        best = Discordance(planned, found.lost, found.won + left_to_win)
        level = self._levels.final / self._levels.tests
        if -best.difference > self._allowed and best.p_value <= level:
            self.ruling = Ruling.REGRESSION
            self.reason = f"{name} stays worse beyond its tolerance however the rest ends"
        worst = Discordance(planned, found.lost + left_to_lose, found.won)
        if -worst.difference <= self._allowed and -tango(worst).low <= self._allowed:
            self.ruling = Ruling.PASSED


def _as_difference(worsening: Estimate) -> Estimate:
    """Return a share's worsening as second minus first."""
    return replace(worsening, value=-worsening.value, low=-worsening.high, high=-worsening.low)
