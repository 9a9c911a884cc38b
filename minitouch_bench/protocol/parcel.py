"""What goes to another machine to run episodes there: the contest, and the files it names."""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from minitouch_bench.cache import materialise
from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.policies.sources import PolicySource, read_checkpoint
from minitouch_bench.protocol.engine import Contest

STEM = "policy"
"""Checkpoints lie in a machine's cache under this name and their digest."""


@dataclass(frozen=True)
class Parcel:
    """A contest as it was named where the run began, and its checkpoints' bytes by SHA-256."""

    contest: Contest
    files: Mapping[str, bytes]


def pack(contest: Contest) -> Parcel:
    """Read the checkpoints of a contest.

    Raises:
        PolicyLoadError: one cannot be read, or is no longer what it was.
    """
    files = {}
    for source in _files_of(contest):
        content = read_checkpoint(Path(source.target))
        if hashlib.sha256(content).hexdigest() != source.digest:
            raise PolicyLoadError(f"{source.target} was changed since this evaluation began")
        files[source.digest] = content
    return Parcel(contest, files)


def unpack(parcel: Parcel) -> tuple[Contest, dict[str, str]]:
    """Return the contest with its checkpoints in this machine's cache, and their old names.

    The bytes in the cache are compared with the parcel's. The names are by the new ones.

    Raises:
        InfrastructureError: the cache cannot be written.
    """
    contest = parcel.contest
    places = {
        source.target: str(
            materialise(STEM, Path(source.target).suffix, parcel.files[source.digest])
        )
        for source in _files_of(contest)
    }
    here = replace(
        contest,
        policy=_moved(contest.policy, places),
        exploration=contest.exploration and _moved(contest.exploration, places),
    )
    return here, {new: old for old, new in places.items()}


def _files_of(contest: Contest) -> Iterator[PolicySource]:
    for source in (contest.policy, contest.exploration):
        if source is not None:
            leaves = [part for _, part in source.parts] or [source]
            yield from (leaf for leaf in leaves if leaf.digest)


def _moved(source: PolicySource, places: Mapping[str, str]) -> PolicySource:
    parts = tuple((task, _moved(part, places)) for task, part in source.parts)
    return replace(source, target=places.get(source.target, source.target), parts=parts)
