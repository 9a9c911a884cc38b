"""The workers on a Ray cluster: which nodes have room, and what became of each episode."""

import contextlib
import re
import socket
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.evaluation.remote_worker import (
    EpisodeWorker,
    Machine,
    WorkerPayload,
    this_machine,
)
from minitouch_bench.optional import require
from minitouch_bench.policies.wire import plain_line
from minitouch_bench.processes import ARITHMETIC, MAX_ATTEMPTS
from minitouch_bench.records import EpisodeRecord, EpisodeSpec

LOOK_S = 5.0
"""How often to look whether nodes have joined while no episode ends, in s."""

NODE_LABEL = "ray.io/node-id"
"""Label that Ray gives every node."""

NODE_IN_ERROR = re.compile(r"\bip=([^,)\s]+)")
"""Where Ray's account of a worker that could not be made names the node."""


@dataclass(frozen=True)
class WorkerReport:
    """A worker's answer when it has been placed; with a ``problem`` it can run nothing."""

    node_id: str
    address: str
    machine: Machine
    problem: str


class RayWorker(EpisodeWorker):
    """An episode worker that says which node Ray has placed it on."""

    def report(self, asked: Machine, payload: list[Any]) -> WorkerReport:
        """Get ready; ``payload`` holds a reference, which Ray does not read inside a list."""
        ray = require("ray", "ray")
        problem = self.prepare(asked, lambda: ray.get(payload[0]))
        address = f"{ray.util.get_node_ip_address()} ({socket.gethostname()})"
        node_id = ray.get_runtime_context().get_node_id()
        return WorkerReport(node_id, address, this_machine(), problem)


@dataclass(frozen=True)
class FailedAttempt:
    """An attempt at an episode that gave no record, and the node it was made on."""

    reason: str
    node_id: str


@dataclass
class _Worker:
    """One actor; with no ``spec`` it is waiting for its place or getting ready."""

    actor: Any
    spec: EpisodeSpec | None = None
    report: WorkerReport | None = None


class RayPool:
    """As many workers as the cluster has CPUs for, on nodes that can give the same numbers."""

    def __init__(
        self,
        ray: ModuleType,
        payload: WorkerPayload,
        limit: int | None,
        note: Callable[[str], None],
    ) -> None:
        self._ray = ray
        # Numeric libraries read these when they are loaded, so before the process's first line.
        self._worker_class = ray.remote(RayWorker).options(
            num_cpus=1, runtime_env={"env_vars": ARITHMETIC}
        )
        self._payload = ray.put(payload)
        self._machine = this_machine()
        self._limit = limit
        self._note = note
        self._noted: set[str] = set()
        self._busy: dict[Any, _Worker] = {}
        self._idle: list[_Worker] = []
        self._excluded: set[str] = set()
        self._false_starts = 0

    def is_busy(self) -> bool:
        """Tell whether an episode is being run."""
        return any(worker.spec for worker in self._busy.values())

    def add_workers(self, episodes: int) -> None:
        """Ask for workers that there is room for, no more than there are episodes.

        Raises:
            InfrastructureError: every node was refused.
        """
        room = self._room()
        if room == 0 and not self._busy and not self._idle:
            raise InfrastructureError("no node of the cluster can run these episodes")
        present = len(self._busy) + len(self._idle)
        coming = sum(worker.spec is None for worker in self._busy.values()) + len(self._idle)
        wanted = room if self._limit is None else min(room, self._limit)
        for _ in range(min(wanted - present, episodes - coming)):
            worker = _Worker(self._make_actor())
            self._busy[worker.actor.report.remote(self._machine, [self._payload])] = worker

    def assign(self, episodes: deque[EpisodeSpec]) -> None:
        """Give each idle worker an episode."""
        while self._idle and episodes:
            worker = self._idle.pop()
            worker.spec = episodes.popleft()
            self._busy[worker.actor.run.remote(worker.spec)] = worker

    def results(self) -> Iterator[tuple[EpisodeSpec, EpisodeRecord | FailedAttempt]]:
        """Wait a while and yield what has ended since.

        Raises:
            InfrastructureError: workers cannot be started.
        """
        done, _ = self._ray.wait(list(self._busy), timeout=LOOK_S)
        for reference in done:
            worker = self._busy.pop(reference)
            if worker.report is None:
                self._admit(worker, reference)
            else:
                spec, worker.spec = worker.spec, None
                assert spec is not None
                yield spec, self._result(worker, worker.report, reference)

    def count_attempts(self, failed: Sequence[FailedAttempt]) -> int:
        """Return how many of an episode's failed attempts were on nodes that are still there."""
        alive = {node["NodeID"] for node in self._ray.nodes() if node["Alive"]}
        return sum(loss.node_id in alive for loss in failed)

    def close(self) -> None:
        """End every worker; what it was doing is lost."""
        for worker in (*self._busy.values(), *self._idle):
            self._kill(worker)

    def _room(self) -> int:
        """Return the CPUs of the nodes that may be used; 1 to wait for the first node."""
        nodes = [node for node in self._ray.nodes() if node["Alive"]]
        cpus = {node["NodeID"]: int(node["Resources"].get("CPU", 0)) for node in nodes}
        room = sum(count for node_id, count in cpus.items() if node_id not in self._excluded)
        return room if self._excluded else max(room, 1)

    def _make_actor(self) -> Any:
        if not self._excluded:
            return self._worker_class.remote()
        others = {NODE_LABEL: f"!in({','.join(sorted(self._excluded))})"}
        return self._worker_class.options(label_selector=others).remote()

    def _result(
        self, worker: _Worker, report: WorkerReport, reference: Any
    ) -> EpisodeRecord | FailedAttempt:
        try:
            result: EpisodeRecord | str = self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            result = f"its worker on {report.address} was lost ({type(error).__name__})"
            self._note_once(
                f"a worker on {report.address} was lost: what it was doing is run again"
            )
        else:
            if isinstance(result, EpisodeRecord):
                self._idle.append(worker)
                return result
            result = f"{result} (on {report.address})"
        self._kill(worker)
        return FailedAttempt(result, report.node_id)

    def _admit(self, worker: _Worker, reference: Any) -> None:
        """Take in a worker that has been placed, unless its node cannot do."""
        try:
            report: WorkerReport = self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            self._kill(worker)
            self._count_false_start(error)
            return
        self._false_starts = 0
        worker.report = report
        if report.problem:
            self._exclude({report.node_id}, report.address, report.problem)
            self._kill(worker)
            return
        self._idle.append(worker)
        if unlike := report.machine.unlike(self._machine):
            self._note_once(
                f"node {report.address} has {unlike}: numbers may differ in their last bits there"
            )

    def _count_false_start(self, error: Exception) -> None:
        """Exclude a node that cannot read our code; give up after too many failed starts."""
        text = str(error)
        named = NODE_IN_ERROR.search(text)
        if named and getattr(error, "actor_init_failed", False):
            address = named[1]
            there = {n["NodeID"] for n in self._ray.nodes() if n["NodeManagerAddress"] == address}
            self._exclude(there, address, text.strip().splitlines()[-1])
            return
        self._false_starts += 1
        if self._false_starts > MAX_ATTEMPTS * max(1, self._room()):
            reason = plain_line(text.strip().splitlines()[-1])
            raise InfrastructureError(f"workers cannot be started on the cluster: {reason}")

    def _exclude(self, node_ids: set[str], address: str, problem: str) -> None:
        self._excluded |= node_ids
        self._note_once(f"node {address} is refused: {problem}")

    def _kill(self, worker: _Worker) -> None:
        with contextlib.suppress(self._ray.exceptions.RayError, ValueError):
            self._ray.kill(worker.actor)

    def _note_once(self, text: str) -> None:
        """Note each thing once: a node has many workers. Ray colors some of its words."""
        text = plain_line(text)
        if text not in self._noted:
            self._noted.add(text)
            self._note(text)
