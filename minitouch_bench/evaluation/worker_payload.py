"""What goes to another machine to run episodes there: the policies, and the files they name."""

import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from minitouch_bench.cache import cache_file
from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.evaluation.rollout import ActorSource
from minitouch_bench.policies.sources import PolicySource, read_checkpoint

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
