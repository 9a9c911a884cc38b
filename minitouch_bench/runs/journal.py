"""The journal of an unfinished run: its header and its finished episodes, a line of JSON each.

Each line begins with the CRC-32 of its JSON, and each but the first with its own line break. So a
line that a crash or a full disk cut short costs its own episode, and never the next one.
"""

import os
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import msgspec

from minitouch_bench.conditions import Conditions
from minitouch_bench.documents import read_json
from minitouch_bench.errors import InfrastructureError, RunDirectoryError
from minitouch_bench.files import (
    GIB,
    JOURNAL_FILE,
    open_plain,
    os_errors_as,
    read_file,
    write_file,
)
from minitouch_bench.optional import compare_versions
from minitouch_bench.records import (
    EpisodeRecord,
    EpisodeSpec,
    EpisodeTrace,
    Outcome,
    PolicyIdentity,
)
from minitouch_bench.runs.actions import pack_arrays, unpack_arrays
from minitouch_bench.runs.run import RunHeader

LARGEST_JOURNAL = 3 * GIB // 2
"""Bytes; the largest run, 10,000 episodes per task in both roles, takes 1 GiB."""

ARRAYS = tuple(field.name for field in fields(EpisodeTrace) if field.name != "first_touch_tick")


@dataclass(frozen=True)
class _FirstLine:
    """What the episodes are played with."""

    header: RunHeader
    packages: Mapping[str, str]


@dataclass(frozen=True)
class _EpisodeLine:
    """A finished episode; ``arrays`` are those of its trace, as the bytes of an ``.npz`` file."""

    spec: EpisodeSpec
    outcome: Outcome
    fault: str
    first_touch_tick: int
    arrays: bytes


class Journal:
    """What is kept of a run in its locked directory until the run is finished."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self.path = directory / JOURNAL_FILE

    def begin(self, header: RunHeader, packages: Mapping[str, str]) -> None:
        """Begin a run.

        Raises:
            RunDirectoryError: the file cannot be written.
        """
        write_file(self.path, _as_line(_FirstLine(header, packages)))

    def keep(self, record: EpisodeRecord) -> None:
        """Add a finished episode; it survives whatever happens after this returns.

        Raises:
            InfrastructureError: the disk is full or fails; the earlier episodes stay.
        """
        trace = record.trace
        arrays = pack_arrays({name: getattr(trace, name) for name in ARRAYS})
        head = (record.spec, record.outcome, record.fault, trace.first_touch_tick)
        line = b"\n" + _as_line(_EpisodeLine(*head, arrays))
        with os_errors_as(InfrastructureError, self.path, "written"):
            handle = open_plain(self.path, os.O_WRONLY | os.O_APPEND)
            with os.fdopen(handle, "ab") as file:
                file.write(line)
                file.flush()
                os.fsync(handle)

    def check(self, header: RunHeader, packages: Mapping[str, str]) -> None:
        """Refuse to go on with another run, or with other packages.

        Raises:
            RunDirectoryError: the text names the differences.
        """
        first = self._lines()[0]
        if first is None:
            raise RunDirectoryError(f"{self.path} has no header: start again with --fresh")
        stored = read_json(first, _FirstLine, str(self.path))
        check_same(header, stored.header, self._directory)
        if differences := compare_versions(stored.packages, packages):
            raise RunDirectoryError(
                f"{self._directory} was begun with other packages: {differences}.\n"
                "Install those, or start again with --fresh"
            )

    def records(self, specs: Sequence[EpisodeSpec]) -> tuple[EpisodeRecord, ...]:
        """Return those of the episodes that are finished, in the order of ``specs``.

        Raises:
            RunDirectoryError: the file cannot be read.
        """
        done: dict[EpisodeSpec, EpisodeRecord] = {}
        for line in filter(None, self._lines()[1:]):
            record = _parse_record(line, str(self.path))
            done[record.spec] = record
        return tuple(done[spec] for spec in specs if spec in done)

    def remove(self) -> None:
        """Remove the journal: the run is finished.

        Raises:
            RunDirectoryError: it cannot be removed.
        """
        with os_errors_as(RunDirectoryError, self.path, "removed"):
            self.path.unlink(missing_ok=True)

    def _lines(self) -> list[bytes | None]:
        """Return the JSON of each line, None where it is damaged."""
        with os_errors_as(RunDirectoryError, self.path, "read"):
            return [*map(_content, read_file(self.path, LARGEST_JOURNAL).split(b"\n"))]


def _as_line(document: object) -> bytes:
    text = msgspec.json.encode(document)
    return b"%08x " % zlib.crc32(text) + text


def _content(line: bytes) -> bytes | None:
    text = line[9:]
    return text if line[:9] == b"%08x " % zlib.crc32(text) else None


def _parse_record(line: bytes, name: str) -> EpisodeRecord:
    stored = read_json(line, _EpisodeLine, name)
    arrays = dict(unpack_arrays(stored.arrays, len(ARRAYS)))
    trace = EpisodeTrace(**arrays, first_touch_tick=stored.first_touch_tick)
    return EpisodeRecord(stored.spec, stored.outcome, trace, stored.fault)


def check_same(asked: RunHeader, there: RunHeader, directory: Path) -> None:
    """Refuse to go on with a run of other settings.

    Raises:
        RunDirectoryError: the text names the differences.
    """
    settings = _flat(asked)
    differences = [
        f"{name}: {_in_words(value)} there, {_in_words(settings[name])} asked for"
        for name, value in _flat(there).items()
        if value != settings[name]
    ]
    if differences:
        raise RunDirectoryError(
            f"{directory} holds another run and cannot be resumed.\n" + "; ".join(differences)
        )


def _flat(header: RunHeader) -> dict[str, object]:
    values: dict[str, object] = {}
    for record in (header, header.plan, header.plan.limits):
        values |= {field.name: getattr(record, field.name) for field in fields(record)}
    for name in ("policy", "exploration"):
        policy = getattr(header, name)
        if policy is not None and policy.digest:  # the same bytes, wherever they are now
            values[name] = replace(policy, source="")
    return {name: value for name, value in values.items() if name not in ("plan", "limits")}


def _in_words(value: object) -> str:
    if isinstance(value, PolicyIdentity):
        return f"{value.name} {value.digest[:12]}".rstrip()
    if isinstance(value, Conditions):
        return ", ".join(value.in_words()) or "none"
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or "none"
    return "none" if value is None else str(value)
