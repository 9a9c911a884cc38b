"""The far side of the Ray engine: what goes to a node of the cluster, and what runs there."""

import hashlib
import os
import platform
import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from minitouch_bench.cache import cache_file
from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.evaluation.rollout import ActorSource, EpisodeRunner
from minitouch_bench.evaluation.run import package_versions
from minitouch_bench.optional import require
from minitouch_bench.policies.sources import PolicySource, read_checkpoint
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import EpisodeRecord, EpisodeSpec

STEM = "policy"
"""Checkpoints lie in a machine's cache under this name and their digest."""


@dataclass(frozen=True)
class WorkerPayload:
    """A source of actors as it is where the run began, and its checkpoints' bytes by SHA-256.

    ``attempts`` is the run's folder of attempts, for machines that have it too.
    """

    source: ActorSource
    files: Mapping[str, bytes]
    attempts: Path | None = None


def pack(source: ActorSource, attempts: Path | None = None) -> WorkerPayload:
    """Read the checkpoints of a run's policies; a recording has none.

    Raises:
        PolicyLoadError: one cannot be read, or is no longer what it was.
    """
    files = {}
    for policy in _files_of(source):
        content = read_checkpoint(Path(policy.target))
        if hashlib.sha256(content).hexdigest() != policy.digest:
            raise PolicyLoadError(f"{policy.target} was changed since this evaluation began")
        files[policy.digest] = content
    return WorkerPayload(source, files, attempts and attempts.resolve())


def unpack(payload: WorkerPayload) -> tuple[ActorSource, dict[str, str]]:
    """Return the source with its checkpoints in this machine's cache, and their old names.

    The bytes in the cache are compared with the payload's. The names are by the new ones.

    Raises:
        InfrastructureError: the cache cannot be written.
    """
    source = payload.source
    if not isinstance(source, PolicySetup):
        return source, {}
    paths = {
        policy.target: str(
            cache_file(STEM, Path(policy.target).suffix, payload.files[policy.digest])
        )
        for policy in _files_of(source)
    }
    here = replace(
        source,
        policy=_moved(source.policy, paths),
        exploration=source.exploration and _moved(source.exploration, paths),
    )
    return here, {new: old for old, new in paths.items()}


def attempts_here(payload: WorkerPayload) -> Path | None:
    """Return the run's folder of attempts if this machine can write to it."""
    folder = payload.attempts
    return folder if folder is not None and os.access(folder, os.W_OK | os.X_OK) else None


def _files_of(source: ActorSource) -> Iterator[PolicySource]:
    if not isinstance(source, PolicySetup):
        return
    for policy in (source.policy, source.exploration):
        if policy is not None:
            leaves = [part for _, part in policy.parts] or [policy]
            yield from (leaf for leaf in leaves if leaf.digest and not leaf.content)


def _moved(policy: PolicySource, paths: Mapping[str, str]) -> PolicySource:
    parts = tuple((task, _moved(part, paths)) for task, part in policy.parts)
    return replace(policy, target=paths.get(policy.target, policy.target), parts=parts)


PACKAGE = "minitouch-bench"


@dataclass(frozen=True)
class Machine:
    """What an episode's bits depend on beside the episode and the policy, by name."""

    protocol_digest: str
    parts: dict[str, str]


@dataclass(frozen=True)
class WorkerReport:
    """A worker's answer when it has been placed; with a ``problem`` it can run nothing."""

    node_id: str
    address: str
    machine: Machine
    problem: str = ""


def this_machine() -> Machine:
    """Describe the machine that this is called on."""
    parts = {
        **package_versions(),
        "the C library": " ".join(platform.libc_ver()),
        "the processor": _processor_class(),
    }
    return Machine(PROTOCOL.digest(), parts)


def _processor_class() -> str:
    """Return the class of processors that give the same bits: see ``processes.ARITHMETIC``."""
    kind = platform.machine()
    if kind != "x86_64":
        return kind
    words = Path("/proc/cpuinfo").read_text(encoding="utf-8").split()
    return f"{kind} {'with' if 'avx2' in words else 'without'} AVX2"


class EpisodeWorker:
    """Runs one episode at a time."""

    _runner: EpisodeRunner
    _old_names: dict[str, str]

    def prepare(self, asked: Machine, payload: list[Any]) -> WorkerReport:
        """Check that this machine plays the protocol asked for, and unpack the policies.

        ``payload`` holds Ray's reference to it: another version could not even read it.
        """
        ray = require("ray", "ray")
        here = this_machine()
        problem = _difference(here, asked)
        if not problem:
            try:
                content = ray.get(payload[0])
                source, self._old_names = unpack(content)
                self._runner = EpisodeRunner(source, attempts_here(content))
            except Exception as error:
                problem = f"{type(error).__name__}: {error}"
        address = f"{ray.util.get_node_ip_address()} ({socket.gethostname()})"
        return WorkerReport(ray.get_runtime_context().get_node_id(), address, here, problem)

    def run(self, spec: EpisodeSpec) -> EpisodeRecord | str:
        """Return the episode's record, or what went wrong with this machine in words."""
        try:
            record = self._runner.run(spec)
        except Exception as error:
            return self._as_named(f"{type(error).__name__}: {error}")
        return replace(record, fault=self._as_named(record.fault))

    def _as_named(self, text: str) -> str:
        """Put the names of checkpoints as the user gave them where the cache's are."""
        for new, old in self._old_names.items():
            text = text.replace(new, old)
        return text


def _difference(here: Machine, asked: Machine) -> str:
    ours, theirs = asked.parts.get(PACKAGE, ""), here.parts.get(PACKAGE, "")
    if ours != theirs:
        return f"it has minitouch-bench {theirs}, and {ours} is asked for"
    if here.protocol_digest != asked.protocol_digest:
        return (
            f"its protocol is {here.protocol_digest[:12]}, and {asked.protocol_digest[:12]} is "
            "asked for: another code, shape set or simulator"
        )
    return ""
