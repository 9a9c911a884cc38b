"""The journal of an unfinished run: its header and its finished episodes, a line of JSON each.

Each line begins with the CRC-32 of its JSON, and each but the first with its own line break. So a
line that a crash or a full disk cut short costs its own episode, and never the next one.
"""

import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path

import msgspec

from minitouch_bench import files
from minitouch_bench.episode import (
    EpisodeSpec,
    Outcome,
    PlayedEpisode,
    PolicyIdentity,
    Start,
    Trace,
)
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.json_io import read_json
from minitouch_bench.machine import compare_versions
from minitouch_bench.perturbation import Perturbation
from minitouch_bench.runs.actions import pack_arrays, unpack_arrays
from minitouch_bench.runs.plan import NAMED_IN_LABEL, first_of
from minitouch_bench.runs.run import RunHeader
from minitouch_bench.text import plain_line

LARGEST_JOURNAL = 3 * files.GIB // 2
"""Bytes; the largest run, 10,000 episodes per task in both roles, takes 1.2 GiB."""

CONSEQUENCES = {"task_digests", "official", "unofficial_because"}
"""Facts of a header that follow from its others."""

ARRAYS = tuple(field.name for field in fields(Trace) if field.name != "first_touch_tick")


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
    start: Start
    fault: str
    first_touch_tick: int
    arrays: bytes


class Journal:
    """A run that is not finished: its header, and the records of its finished episodes.

    It has no estimates, and so it is not a ``Run``. ``directory`` None: it is kept in memory only;
    otherwise each record is in the journal's file too, and survives a kill or a full disk.
    """

    def __init__(self, header: RunHeader, directory: Path | None = None) -> None:
        self.header = header
        self.directory = directory
        self.records: dict[EpisodeSpec, PlayedEpisode] = {}

    @classmethod
    def begin(cls, header: RunHeader, packages: Mapping[str, str], directory: Path) -> "Journal":
        """Begin a run in a locked directory.

        Raises:
            RunDirectoryError: the file cannot be written.
        """
        files.write_file(directory / files.JOURNAL_FILE, _as_line(_FirstLine(header, packages)))
        return cls(header, directory)

    @classmethod
    def resume(cls, header: RunHeader, packages: Mapping[str, str], directory: Path) -> "Journal":
        """Read what is finished of a run in a locked directory.

        Raises:
            RunDirectoryError: the file cannot be read, or the run there has another header or other
                packages; the text names the differences.
        """
        path, journal = directory / files.JOURNAL_FILE, cls(header, directory)
        stored, others = _read(path)
        check_same(header, stored.header, directory)
        if differences := compare_versions(stored.packages, packages):
            raise RunDirectoryError(
                f"{directory} was begun with other packages, which --resume needs: {differences}"
            )
        lines = (read_json(line, _EpisodeLine, str(path)) for line in others if line is not None)
        found = {line.spec: line for line in lines}
        journal.records = {
            spec: _unpack(found[spec], str(path)) for spec in header.specs() if spec in found
        }
        return journal

    def keep(self, record: PlayedEpisode) -> None:
        """Add a finished episode; with a directory it survives whatever happens after this returns.

        Raises:
            RunDirectoryError: the disk is full or fails; the earlier episodes stay.
        """
        if self.directory is not None:
            trace = record.trace
            arrays = pack_arrays({name: getattr(trace, name) for name in ARRAYS})
            how = (record.spec, record.outcome, record.start, record.fault)
            line = _EpisodeLine(*how, trace.first_touch_tick, arrays)
            files.append_bytes(self.directory / files.JOURNAL_FILE, b"\n" + _as_line(line))
        self.records[record.spec] = record

    def remove(self) -> None:
        """Remove the file: the run is finished.

        Raises:
            RunDirectoryError: it cannot be removed.
        """
        if self.directory is not None:
            path = self.directory / files.JOURNAL_FILE
            with files.os_errors_as(RunDirectoryError, path, "removed"):
                path.unlink(missing_ok=True)


def _read(path: Path) -> tuple[_FirstLine, list[bytes | None]]:
    """Return a journal's first line, and the contents of its others, None of a damaged one."""
    with files.os_errors_as(RunDirectoryError, path, "read"):
        first, *others = map(_content, files.read_file(path, LARGEST_JOURNAL).split(b"\n"))
    if first is None:
        raise RunDirectoryError(f"{path} has no header")
    return read_json(first, _FirstLine, str(path)), others


def _as_line(document: object) -> bytes:
    """Return a document's line, without the line break."""
    text = msgspec.json.encode(document)
    return b"%08x " % zlib.crc32(text) + text


def _content(line: bytes) -> bytes | None:
    text = line[9:]
    return text if line[:9] == b"%08x " % zlib.crc32(text) else None


def _unpack(stored: _EpisodeLine, name: str) -> PlayedEpisode:
    with files.damage_as(RunDirectoryError, f"{name} is damaged"):
        arrays = dict(unpack_arrays(stored.arrays, len(ARRAYS)))
        trace = Trace(**arrays, first_touch_tick=stored.first_touch_tick)
    return PlayedEpisode(stored.spec, stored.outcome, stored.start, trace, stored.fault)


def check_same(asked: RunHeader, there: RunHeader, directory: Path) -> None:
    """Refuse to go on with a run of other settings.

    Raises:
        RunDirectoryError: the text names the run and the differences.
    """
    old, new = _flat(there), _flat(asked)
    differing = [name for name in old if old[name] != new[name]]
    if differing:
        differences = [
            f"{name}: {_in_words(old[name])} there, {_in_words(new[name])} asked for"
            for name in [name for name in differing if name not in CONSEQUENCES] or differing
        ]
        raise RunDirectoryError(
            f"{directory} contains another run, of {there.policy.name} on {there.plan.suite}; "
            + "; ".join(differences)
        )


def _flat(header: RunHeader) -> dict[str, object]:
    values = {**vars(header), **vars(header.plan), **vars(header.plan.limits)}
    del values["plan"], values["limits"], values["protocol_digest"]
    for name in ("policy", "exploration"):
        if values[name] is not None and values[name].digest:  # the same bytes, wherever they are
            values[name] = replace(values[name], source="")
    return values


def _in_words(value: object) -> str:
    if isinstance(value, PolicyIdentity):
        return f"{value.name} {value.digest[:12]}".rstrip()
    if isinstance(value, Perturbation):
        return ", ".join(value.in_words()) or "none"
    if isinstance(value, tuple):
        return first_of([*map(str, value)], NAMED_IN_LABEL) or "none"
    text = "none" if value in (None, msgspec.UNSET) else str(value)
    return text[:12] if re.fullmatch("[0-9a-f]{64}", text) else plain_line(text, 80)
