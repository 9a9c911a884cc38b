"""``journal.jsonl``: one line per episode, written and synced as it ends.

Each line is ``{"crc32": "01234567", "body": {...}}``, the checksum taken over the body's
text. The first body is the run's header. A torn last line is what a crash leaves; it is cut.
A bad line before the last is damage, and refused.
"""

import base64
import json
import os
import zlib
from collections.abc import Iterator
from dataclasses import asdict, fields
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from msgspec import convert, to_builtins

from minitouch_bench.errors import InfrastructureError, RunDirectoryError
from minitouch_bench.files import JOURNAL_FILE, os_errors_as, read_file
from minitouch_bench.records import (
    EpisodeRecord,
    EpisodeSpec,
    EpisodeTrace,
    Outcome,
    Role,
    RunHeader,
)

_PREFIX, _MIDDLE, _SUFFIX = b'{"crc32":"', b'","body":', b"}\n"
_BODY_START = len(_PREFIX) + 8 + len(_MIDDLE)


class Journal:
    """The writer of a run's journal; there is one at a time, see ``files.lock_directory``."""

    def __init__(self, directory: Path) -> None:
        self._path = directory / JOURNAL_FILE
        self._file = os.open(
            self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o644
        )

    def __enter__(self) -> "Journal":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        os.close(self._file)

    def write_header(self, header: RunHeader) -> None:
        """Write the first line."""
        self._append({"format": "minitouch-journal", "version": 1, "header": to_builtins(header)})

    def write_record(self, record: EpisodeRecord) -> None:
        """Write one episode; it survives whatever happens after this returns.

        Raises:
            InfrastructureError: the disk is full or fails; what is written stays good.
        """
        self._append(_encode_record(record))

    def _append(self, body: dict[str, Any]) -> None:
        text = json.dumps(body, separators=(",", ":"), allow_nan=False)
        line = _framed(text.encode())
        end = os.fstat(self._file).st_size
        try:
            written = os.write(self._file, line)
            os.fsync(self._file)
        except OSError as error:
            os.truncate(self._path, end)
            raise InfrastructureError(
                f"{self._path} cannot be written: {error.strerror}"
            ) from error
        if written < len(line):  # a disk that fills up first writes short
            os.truncate(self._path, end)
            raise InfrastructureError(f"{self._path} cannot be written: no space left on device")


class JournalContent(NamedTuple):
    """What a journal holds; ``torn``: its last line was not whole."""

    header: RunHeader
    records: list[EpisodeRecord]
    torn: bool


def read_journal(directory: Path, *, repair: bool = True) -> JournalContent:
    """Read a journal; ``repair`` cuts off a last line that is torn.

    Raises:
        RunDirectoryError: there is no journal, or it is damaged before its end.
    """
    path = directory / JOURNAL_FILE
    with os_errors_as(RunDirectoryError, path, "read"):
        content = read_file(path)
    bodies: list[dict[str, Any]] = []
    good_until = 0
    for number, end, line in _lines(content):
        body = _checked(line)
        if body is None:
            if end < len(content):
                raise RunDirectoryError(
                    f"{path}: line {number} is damaged.\nStart again with --fresh"
                )
            break
        bodies.append(body)
        good_until = end
    torn = good_until < len(content)
    if torn and repair:
        os.truncate(path, good_until)
    if not bodies:
        raise RunDirectoryError(f"{path} holds nothing that can be resumed; start with --fresh")
    try:
        records = [_decode_record(body) for body in bodies[1:]]
        return JournalContent(convert(bodies[0]["header"], RunHeader), records, torn)
    except (KeyError, TypeError, ValueError, zlib.error) as error:
        raise RunDirectoryError(f"{path} is of another version: {error!r}") from error


def _lines(content: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield each line's number, the offset of its end, and its text with the line break."""
    end = 0
    for number, line in enumerate(content.splitlines(keepends=True), start=1):
        end += len(line)
        yield number, end, line


def _framed(text: bytes) -> bytes:
    """Return the line of a body's text."""
    return b"%b%08x%b%b%b" % (_PREFIX, zlib.crc32(text), _MIDDLE, text, _SUFFIX)


def _checked(line: bytes) -> dict[str, Any] | None:
    text = line[_BODY_START : -len(_SUFFIX)]
    if line != _framed(text):
        return None
    try:
        body = json.loads(text)
    except ValueError:
        return None
    return body if isinstance(body, dict) else None


def _encode_record(record: EpisodeRecord) -> dict[str, Any]:
    trace: dict[str, Any] = {}
    for field in fields(EpisodeTrace):
        value = getattr(record.trace, field.name)
        if isinstance(value, np.ndarray):
            data = base64.b64encode(zlib.compress(np.ascontiguousarray(value).tobytes(), 6))
            trace[field.name] = [value.dtype.str, list(value.shape), data.decode()]
        else:
            trace[field.name] = value
    return {
        "spec": asdict(record.spec),
        "outcome": record.outcome,
        "fault": record.fault,
        "digest": record.trace.digest(),
        "trace": trace,
    }


def _decode_record(body: dict[str, Any]) -> EpisodeRecord:
    values: dict[str, Any] = {}
    for name, value in body["trace"].items():
        if isinstance(value, list):
            dtype, shape, data = value
            raw = zlib.decompress(base64.b64decode(data, validate=True))
            values[name] = np.frombuffer(raw, dtype).reshape(shape).copy()
        else:
            values[name] = value
    spec = EpisodeSpec(**{**body["spec"], "role": Role(body["spec"]["role"])})
    trace = EpisodeTrace(**values)
    if trace.digest() != body["digest"]:
        raise ValueError(f"the trace of {spec.key} does not have its digest")
    return EpisodeRecord(spec, Outcome(body["outcome"]), trace, body["fault"])
