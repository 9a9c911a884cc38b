"""The gate that looks after every episode, and stops as soon as its answer is certain.

Half of the gate's level is for stopping early, half for judging a run that was played to its
end, so that together a false answer keeps the level:

- a regression, by an e-process over all metrics and tasks (Bonferroni), or because no outcome
  of the remaining episodes could change what the whole run will be judged to be;
- no regression, by a confidence sequence in every metric of every task.

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
from minitouch_bench.regression.binomial import mcnemar_p
from minitouch_bench.regression.effects import Effect, worse_sign
from minitouch_bench.regression.evidence import (
    evidence_of_loss,
    evidence_of_no_loss,
    evidence_of_worsening,
    mean_sequence,
    share_sequence,
)
from minitouch_bench.regression.gate import Judgement, Ruling, overall
from minitouch_bench.regression.pairing import (
    SHARE_METRICS,
    EpisodePair,
    Sample,
    collect_samples,
    episode_key,
    refuse_other_episode,
    value_of,
)
from minitouch_bench.regression.power import MeanResolution, ShareResolution
from minitouch_bench.regression.shares import Discordance, count_discordance, tango
from minitouch_bench.regression.tolerances import GateSettings

FEWEST_FOR_A_SEQUENCE = 30
"""Episodes below which the asymptotic confidence sequence of a mean is not looked at."""


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
    """Chances of a false answer: of early ones, and of the judgement of a whole run."""

    early: float
    final: float
    tests: int

    @classmethod
    def of(cls, settings: GateSettings, tests: int) -> "Levels":
        """Split the gate's level in halves."""
        return cls(settings.alpha / 2.0, settings.alpha / 2.0, tests)


class SequentialGate:
    """Takes a candidate's episodes as they end, and says when to stop.

    ``order``: the baseline's episodes as ``play_order`` has them.
    """

    def __init__(self, order: Sequence[EpisodeMetrics], settings: GateSettings) -> None:
        self._order = tuple(order)
        self.settings = settings
        self._waiting: dict[str, EpisodeMetrics] = {}
        self._pairs: list[EpisodePair] = []
        mirror = [EpisodePair(Role.FINAL, episode, episode) for episode in order]
        tasks = tuple(dict.fromkeys(episode.task for episode in order))
        samples = [s for s in collect_samples(mirror, tasks) if s.metric in settings.metrics]
        self.levels = Levels.of(settings, len(samples))
        self._cells = [_Cell(sample, settings, self.levels) for sample in samples]

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

    def __init__(self, baseline: Sample, settings: GateSettings, levels: Levels) -> None:
        self.task, self.metric = baseline.task, baseline.metric
        self.ruling, self.reason = Ruling.OPEN, ""
        self._levels = levels
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
        """Return the effect over the episodes seen, with intervals that hold at any stop."""
        sequence, sign = self._sequence(), worse_sign(self.metric)
        ends = sorted((sequence.low * sign, sequence.high * sign))
        differing = int(np.count_nonzero(self._worsenings))
        effect = Effect(
            task=self.task,
            metric=self.metric,
            first=float(np.mean(self._first)),
            second=float(np.mean(self._second)),
            difference=replace(sequence, value=sequence.value * sign, low=ends[0], high=ends[1]),
            p_value=min(1.0, math.exp(-self._highest_evidence)),
            differing=differing,
            resolution=self._resolution(),
        )
        p_value = min(1.0, effect.p_value * self._levels.tests)
        return Judgement(effect, p_value, self._allowed, self.ruling)

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
            return evidence >= math.log(1.0 / self._levels.early)
        return self.count >= FEWEST_FOR_A_SEQUENCE and self._sequence().high <= self._allowed

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
        if -best.difference > self._allowed and mcnemar_p(best.lost, best.won) <= level:
            self.ruling = Ruling.REGRESSION
            self.reason = f"{name} stays worse beyond its tolerance however the rest ends"
        worst = Discordance(planned, found.lost + left_to_lose, found.won)
        if -worst.difference <= self._allowed and -tango(worst).low <= self._allowed:
            self.ruling = Ruling.PASSED

    def _sequence(self) -> Estimate:
        alpha = 2.0 * self._levels.early
        if self.metric in SHARE_METRICS:
            return share_sequence(self._discordance, alpha)
        return mean_sequence(self._worsenings, alpha, self._planned)

    def _resolution(self) -> ShareResolution | MeanResolution:
        if self.metric in SHARE_METRICS:
            return ShareResolution(self._discordance)
        worsenings = self._worsenings
        return MeanResolution(self.count, float(worsenings.mean()), float(worsenings.std()))
