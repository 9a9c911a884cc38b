"""The far side of an engine on other machines: what goes there, and what runs there."""

import platform
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from minitouch_bench.cache import cache_file
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.evaluation.rollout import ActorSource, EpisodeRunner
from minitouch_bench.evaluation.run import package_versions
from minitouch_bench.policies.sources import PolicySource, read_again
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import EpisodeRecord, EpisodeSpec

STEM = "policy"
"""Checkpoints lie in a machine's cache under this name and their digest."""


@dataclass(frozen=True)
class WorkerPayload:
    """A source of actors, and its checkpoints' bytes by SHA-256."""

    source: ActorSource
    files: Mapping[str, bytes]


def pack(source: ActorSource) -> WorkerPayload:
    """Read the checkpoints of a run's policies; a recording has none.

    Raises:
        CheckpointChangedError: one cannot be read, or is no longer what it was.
    """
    files = {file.digest: read_again(file.target, file.digest) for file in _files_of(source)}
    return WorkerPayload(source, files)


def unpack(payload: WorkerPayload) -> tuple[ActorSource, dict[str, str]]:
    """Return the source with its checkpoints in this machine's cache, and their old names.

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


def _files_of(source: ActorSource) -> Iterator[PolicySource]:
    for policy in source.sources() if isinstance(source, PolicySetup) else ():
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

    def refusal(self, asked: "Machine") -> str:
        """Say why this machine cannot play what another one asks for; "" if it can."""
        ours, theirs = self.parts.get(PACKAGE, ""), asked.parts.get(PACKAGE, "")
        if ours != theirs:
            return f"it has minitouch-bench {ours}, and {theirs} is asked for"
        if self.protocol_digest != asked.protocol_digest:
            return (
                f"its protocol is {self.protocol_digest[:12]}, and {asked.protocol_digest[:12]} "
                "is asked for: another code, shape set or simulator"
            )
        return ""

    def unlike(self, other: "Machine") -> str:
        """Say in what this machine differs from another that plays the same protocol."""
        return ", ".join(
            f"{name} {value} (here {other.parts.get(name, 'missing')})"
            for name, value in self.parts.items()
            if value != other.parts.get(name)
        )


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

    def prepare(self, asked: Machine, fetch: Callable[[], WorkerPayload]) -> str:
        """Unpack the policies where versions agree; say why this machine cannot run them, or ""."""
        if problem := this_machine().refusal(asked):
            return problem
        try:
            source, self._old_names = unpack(fetch())
            self._runner = EpisodeRunner(source)
        except Exception as error:
            return f"{type(error).__name__}: {error}"
        return ""

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
