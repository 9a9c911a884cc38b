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

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import replace

from minitouch_bench.metrics.intervals import Root, stream
from minitouch_bench.records import EpisodeMetrics, Role, RunHeader, SavedRun
from minitouch_bench.regression.comparison import (
    ComparedRun,
    differences_of_isolation,
    find_changes,
)
from minitouch_bench.regression.gate import (
    Decision,
    EpisodesUsed,
    GateResult,
    JudgedMetric,
    guarded_values,
    judge_runs,
    overall,
)
from minitouch_bench.regression.metric_watch import AlphaParts, MetricWatch
from minitouch_bench.regression.pairing import EpisodePair, episode_key, refuse_other_episode
from minitouch_bench.regression.settings import GateSettings
from minitouch_bench.reporting.labels import reproduce_command


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


class SequentialGate:
    """Takes a candidate's episodes as they end, and says when to stop.

    ``order``: the baseline's episodes as ``play_order`` has them; ``root`` seeds the bootstrap.

    Raises:
        UsageError: the episodes have none of the metrics that the settings guard.
    """

    def __init__(self, order: Sequence[EpisodeMetrics], settings: GateSettings, root: Root) -> None:
        self._order = tuple(order)
        self.settings = settings
        self._waiting: dict[str, EpisodeMetrics] = {}
        self._pairs: list[EpisodePair] = []
        mirror = [EpisodePair(Role.FINAL, episode, episode) for episode in order]
        tasks = tuple(dict.fromkeys(episode.task for episode in order))
        guarded, _ = guarded_values(mirror, tasks, settings)
        self.alpha = AlphaParts.of(settings.alpha, len(guarded))
        self._watches = [MetricWatch(values, settings, self.alpha, root) for values in guarded]

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
    def decision(self) -> Decision:
        """The answer; OPEN while it is not certain."""
        found = overall([watch.decision for watch in self._watches])
        return Decision.OPEN if found is Decision.INCONCLUSIVE else found

    @property
    def is_certain(self) -> bool:
        """Whether there is an answer."""
        return self.decision is not Decision.OPEN

    @property
    def reason(self) -> str:
        """Why the answer is certain, in words."""
        return next(
            (watch.reason for watch in self._watches if watch.decision is Decision.REGRESSION),
            "every metric is within its tolerance",
        )

    def add(self, episodes: Iterable[EpisodeMetrics]) -> bool:
        """Take episodes in any order; return whether the answer is certain.

        Raises:
            UsageError: one is not the baseline's episode of its name.
        """
        for episode in episodes:
            self._waiting[episode_key(Role.FINAL, episode)] = episode
        while not self.is_certain and self.used < self.planned:
            own = self._order[self.used]
            other = self._waiting.pop(episode_key(Role.FINAL, own), None)
            if other is None:
                break
            pair = EpisodePair(Role.FINAL, own, other)
            refuse_other_episode(pair)
            self._pairs.append(pair)
            for watch in self._watches:
                watch.add(pair)
        return self.is_certain

    def judged(self) -> tuple[JudgedMetric, ...]:
        """Return what is known of each metric that has an episode, at an early stop."""
        return tuple(watch.judged() for watch in self._watches if watch.count)


def early_result(
    gate: SequentialGate, baseline: SavedRun, path: str, candidate: ComparedRun, header: RunHeader
) -> GateResult:
    """Return the result of a gate that is certain; ``header`` is the candidate's."""
    rest = shlex.join(["--output", candidate.path, "--resume"])
    return GateResult(
        baseline=ComparedRun.of("baseline", baseline, path),
        candidate=candidate,
        decision=gate.decision,
        settings=gate.settings,
        identical=False,
        judged=gate.judged(),
        unjudged=(),
        changes=find_changes(gate.pairs, (path, candidate.path)),
        notes=differences_of_isolation(baseline.header, header),
        next_command=f"{reproduce_command(header)} {rest}",
        episodes_used=EpisodesUsed(gate.used, gate.planned, gate.reason),
        unfinished=True,
    )


def final_result(
    baseline: SavedRun, candidate: SavedRun, paths: tuple[str, str], settings: GateSettings
) -> GateResult:
    """Judge a whole run at the part of the level that early stops have left."""
    level = AlphaParts.of(settings.alpha, tests=1).final
    found = judge_runs(baseline, candidate, paths, replace(settings, alpha=level))
    count = len(candidate.episodes)
    used = EpisodesUsed(count, count, "no answer was certain before the end")
    return replace(found, settings=settings, episodes_used=used)
