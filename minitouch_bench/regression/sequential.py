"""A policy that plays the baseline's episodes, and stops as soon as the answer is certain.

The baseline's outcomes are known: where it failed the candidate can only win, where it succeeded
only lose. The answer is certain once the remaining episodes, however they end, leave it as it is.
So an early answer is the answer of the whole run, and costs nothing of the gate's level.

Episodes count in one fixed order, whatever the order they end in: the answer does not depend on
the number of workers.
"""

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import replace

from minitouch_bench.errors import printable
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.intervals import Root, stream
from minitouch_bench.metrics.significance import Discordance, tango
from minitouch_bench.records import EpisodeMetrics, EpisodeSpec, Outcome, Role
from minitouch_bench.regression.comparison import (
    ComparedRun,
    differences_of_isolation,
    find_changes,
)
from minitouch_bench.regression.gate import (
    Decision,
    EpisodesUsed,
    GateResult,
    endpoint_values,
    judge_endpoint,
    measure_tasks,
)
from minitouch_bench.regression.paired_tests import is_binary
from minitouch_bench.regression.pairing import (
    EpisodePair,
    PairedValues,
    episode_key,
    refuse_other_episode,
)
from minitouch_bench.regression.settings import GateSettings
from minitouch_bench.reporting.labels import header_labels, reproduce_command
from minitouch_bench.runs.run import Run, RunHeader


def play_order(episodes: Sequence[EpisodeMetrics], root: Root) -> tuple[EpisodeMetrics, ...]:
    """Return the episodes so that tasks take turns, each task's own in a random order.

    The order is random so that no part of a suite, such as its held-out shapes, comes first;
    it is a function of ``root`` alone.
    """
    queues = []
    for task in dict.fromkeys(episode.task for episode in episodes):
        of_task = [episode for episode in episodes if episode.task == task]
        turns = stream(root, task, "order").permutation(len(of_task))
        queues.append([of_task[turn] for turn in turns])
    longest = max(len(queue) for queue in queues)
    return tuple(queue[turn] for turn in range(longest) for queue in queues if turn < len(queue))


class SequentialGate:
    """Takes a candidate's episodes as they end, and says when to stop.

    Only shares of episodes are ever certain before the end. ``baseline`` has final episodes alone,
    each of a task of the endpoint; ``pairs`` are those the answer rests on, in the order they
    count in.

    Raises:
        UsageError: the episodes have none of the metric.
    """

    def __init__(self, baseline: Run, settings: GateSettings) -> None:
        self._baseline = baseline
        self._root = (baseline.plan.seed,)
        self._order = order = play_order(baseline.episodes, self._root)
        self._turns = {episode_key(Role.FINAL, one): turn for turn, one in enumerate(order)}
        self._settings = settings
        self.decision: Decision | None = None
        self._waiting: dict[str, EpisodeMetrics] = {}
        self.pairs: list[EpisodePair] = []
        self._tasks = tuple(dict.fromkeys(episode.task for episode in order))
        mirror = [EpisodePair(Role.FINAL, episode, episode) for episode in order]
        self._planned = endpoint_values(mirror, self._tasks, settings)
        self._left_to_lose = int(self._planned.first.sum())
        self._lost = self._won = 0
        tolerance = settings.tolerance_of(self._planned.metric)
        self._allowed = tolerance.absolute(float(self._planned.first.mean()))

    @property
    def used(self) -> int:
        """Number of episodes the answer rests on."""
        return len(self.pairs)

    @property
    def planned(self) -> int:
        """Number of episodes of the whole run."""
        return len(self._order)

    def turn(self, spec: EpisodeSpec) -> int:
        """Return when an episode counts: episodes that start in this order need not wait."""
        return self._turns[spec.key]

    @property
    def is_certain(self) -> bool:
        """Whether there is an answer."""
        return self.decision is not None

    def add(self, episodes: Iterable[EpisodeMetrics]) -> bool:
        """Take episodes in any order; return whether the answer is certain.

        Raises:
            UsageError: one is not the baseline's episode of its name.
        """
        for episode in episodes:
            self._waiting[episode_key(Role.FINAL, episode)] = episode
        while not self.is_certain and self.used < self.planned:
            expected = self._order[self.used]
            played = self._waiting.pop(episode_key(Role.FINAL, expected), None)
            if played is None:
                break
            pair = EpisodePair(Role.FINAL, expected, played)
            refuse_other_episode(pair)
            self.pairs.append(pair)
            if is_binary(self._planned.metric):
                self._count(pair)
                self.decision = self._look_ahead()
        return self.is_certain

    def _count(self, pair: EpisodePair) -> None:
        metric = METRICS[self._planned.metric]
        first, second = bool(metric.value(pair.first)), bool(metric.value(pair.second))
        self._left_to_lose -= first
        self._lost += first and not second
        self._won += second and not first

    def _look_ahead(self) -> Decision | None:
        """Return what the whole run will be judged to be, None while that is open."""
        left_to_win = self.planned - self.used - self._left_to_lose
        best = Discordance(self.planned, self._lost, self._won + left_to_win)
        if -best.difference > self._allowed and best.p_value / 2.0 <= self._settings.alpha:
            return Decision.REGRESSION
        worst = Discordance(self.planned, self._lost + self._left_to_lose, self._won)
        if -worst.difference <= self._allowed and -tango(worst).low <= self._allowed:
            return Decision.NO_REGRESSION
        return None

    def result(self, path: str, output: str, header: RunHeader, wall_s: float) -> GateResult:
        """Return the result of a gate that is certain.

        ``path`` and ``output`` are the directories of the baseline and of the candidate's run,
        ``header`` is the candidate's.
        """
        assert self.decision is not None
        planned, settings = self._planned, self._settings
        seen = PairedValues.of(self.pairs, planned.task, planned.metric, planned.tasks)
        endpoint = replace(
            judge_endpoint(seen, settings, self._root),
            decision=self.decision, tolerance=self._allowed, episodes_needed=None,
        )  # fmt: skip
        faults = sum(pair.second.outcome is Outcome.POLICY_FAULT for pair in self.pairs)
        name, labels = printable(header.policy.name), header_labels(header, faults)
        rest = shlex.join(["--output", output, "--resume"])
        return GateResult(
            baseline=ComparedRun.of("baseline", self._baseline, path),
            candidate=ComparedRun("candidate", name, output, labels),
            decision=self.decision,
            settings=settings,
            identical=False,
            endpoint=endpoint,
            per_task=measure_tasks(self.pairs, self._tasks, endpoint, settings.alpha, self._root),
            changes=find_changes(self.pairs, (path, output)),
            notes=differences_of_isolation(self._baseline.header, header),
            next_command=f"{reproduce_command(header)} {rest}",
            wall_s=wall_s,
            episodes_used=EpisodesUsed(
                self.used, self.planned, "the remaining episodes cannot change the answer"
            ),
            unfinished=True,
        )
