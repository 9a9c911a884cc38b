"""``journal.jsonl``: one line per episode, written and synced as it ends.

Each line is ``{"crc32": "01234567", "body": {...}}``, the checksum taken over the body's
text. The first body is the run's header. A torn last line is what a crash leaves; it is cut.
A bad line before the last is damage, and refused. It is read line by line, and what a line
declares is looked at before it is unpacked: no journal takes more memory than its episodes.
"""

import base64
import json
import math
import os
import zlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from msgspec import convert, to_builtins
from numpy.typing import NDArray

from minitouch_bench.documents import read_json
from minitouch_bench.errors import InfrastructureError, RunDirectoryError, UnreadableFileError
from minitouch_bench.files import JOURNAL_FILE, KIB, MIB, open_plain, os_errors_as
from minitouch_bench.records import EpisodeRecord, EpisodeSpec, RunHeader

_PREFIX, _MIDDLE, _SUFFIX = b'{"crc32":"', b'","body":', b"}\n"
_BODY_START = len(_PREFIX) + 8 + len(_MIDDLE)

MAX_LINE = MIB
"""An episode of 200 steps takes some 20 KiB."""
MAX_ARRAY = 256 * KIB
SpecsOf = Callable[[RunHeader], Collection[EpisodeSpec]]
DTYPES = ("<f4", "<f8", "<i2", "|b1")


class _StoredArray(NamedTuple):
    """An array of a trace: its numbers compressed, in base64."""

    dtype: str
    shape: tuple[int, ...]
    data: str


@dataclass(frozen=True)
class _StoredRecord(EpisodeRecord):
    """The body of an episode's line; each array of the trace is a ``_StoredArray``."""

    digest: str = ""


@dataclass(frozen=True)
class _StoredHeader:
    """The body of the first line."""

    header: RunHeader
    packages: Mapping[str, str] = field(default_factory=dict)


class Journal:
    """The writer of a run's journal; there is one at a time, see ``files.lock_directory``.

    Raises:
        RunDirectoryError: the file cannot be opened, or is no plain one.
    """

    def __init__(self, directory: Path) -> None:
        self._path = directory / JOURNAL_FILE
        with os_errors_as(RunDirectoryError, self._path, "written"):
            self._file = open_plain(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._file)

    def write_header(self, header: RunHeader, packages: Mapping[str, str] | None = None) -> None:
        """Write the first line: what fixes the numbers, and the versions that make them."""
        stored = to_builtins(_StoredHeader(header, packages or {}))
        self._append({"format": "minitouch-journal", "version": 1, **stored})

    def write_record(self, record: EpisodeRecord) -> None:
        """Write one episode; it survives whatever happens after this returns.

        Raises:
            InfrastructureError: the disk is full or fails; what is written stays good.
        """
        body = to_builtins(record, enc_hook=_pack)
        self._append({**body, "digest": record.trace.digest()})

    def _append(self, body: dict[str, Any]) -> None:
        text = json.dumps(body, separators=(",", ":"), allow_nan=False)
        line = _framed(text.encode())
        end = os.fstat(self._file).st_size
        try:
            written = os.write(self._file, line)
            os.fsync(self._file)
        except OSError as error:
            os.ftruncate(self._file, end)
            raise InfrastructureError(
                f"{self._path} cannot be written: {error.strerror}"
            ) from error
        if written < len(line):  # a disk that fills up first writes short
            os.ftruncate(self._file, end)
            raise InfrastructureError(f"{self._path} cannot be written: no space left on device")


class JournalContent(NamedTuple):
    """What a journal holds; ``torn``: its last line was not whole."""

    header: RunHeader
    records: list[EpisodeRecord]
    torn: bool


def read_journal(
    directory: Path,
    specs_of: SpecsOf | None = None,
    *,
    packages: Mapping[str, str] | None = None,
    repair: bool = True,
) -> JournalContent:
    """Read a journal; ``repair`` cuts off a last line that is torn.

    ``packages``: the versions that the missing episodes would be run with.

    ``specs_of`` takes the header, which it may refuse, and returns the episodes that may follow,
    each once at most; without it any may.

    Raises:
        UnreadableFileError: there is no journal, or it is no plain file.
        RunDirectoryError: it is damaged before its end, of another run, or of other packages.
    """
    path = directory / JOURNAL_FILE
    with os_errors_as(UnreadableFileError, path, "read"):
        handle = open_plain(path, os.O_RDWR if repair else os.O_RDONLY)
        with os.fdopen(handle, "r+b" if repair else "rb") as file:
            return _read_journal(file, path, specs_of, packages, repair)


def _read_journal(
    file: BinaryIO,
    path: Path,
    specs_of: SpecsOf | None,
    packages: Mapping[str, str] | None,
    repair: bool,
) -> JournalContent:
    wanted: set[EpisodeSpec] = set()
    size = os.fstat(file.fileno()).st_size
    header: RunHeader | None = None
    records: list[EpisodeRecord] = []
    good_until = number = 0
    while line := file.readline(MAX_LINE):
        number += 1
        text = _checked(line)
        if text is None:
            if good_until + len(line) < size:
                raise RunDirectoryError(
                    f"{path}: line {number} is damaged.\nStart again with --fresh"
                )
            break
        name = f"{path}: line {number}"
        if header is None:
            stored = read_json(text, _StoredHeader, name)
            header = stored.header
            _check_packages(path, stored.packages, packages)
            if specs_of is not None:
                wanted = set(specs_of(header))
        else:
            record = _read_record(text, name)
            if specs_of is not None:
                if record.spec not in wanted:
                    raise RunDirectoryError(f"{name} is an episode twice or of another run")
                wanted.remove(record.spec)
            records.append(record)
        good_until += len(line)
    if header is None:
        raise RunDirectoryError(f"{path} holds nothing that can be resumed; start with --fresh")
    torn = good_until < size
    if torn and repair:
        os.ftruncate(file.fileno(), good_until)
    return JournalContent(header, records, torn)


def _check_packages(path: Path, there: Mapping[str, str], here: Mapping[str, str] | None) -> None:
    if here is None or not there or there == here:
        return
    names = sorted(name for name in {*there, *here} if there.get(name) != here.get(name))
    differences = [f"{one} {there.get(one, 'none')} there, {here.get(one, 'none')} here"
                   for one in names]  # fmt: skip
    raise RunDirectoryError(
        f"{path} was begun with other packages: {'; '.join(differences)}.\n"
        "Install those, or start again with --fresh"
    )


def _framed(text: bytes) -> bytes:
    """Return the line of a body's text."""
    return b"%b%08x%b%b%b" % (_PREFIX, zlib.crc32(text), _MIDDLE, text, _SUFFIX)


def _checked(line: bytes) -> bytes | None:
    """Return the text of a line's body, None where the line is not whole."""
    text = line[_BODY_START : -len(_SUFFIX)]
    return text if line == _framed(text) else None


def _read_record(text: bytes, name: str) -> EpisodeRecord:
    """Read the body of an episode's line; ``name`` begins the text of an error.

    Raises:
        RunDirectoryError: it is none, or its arrays are not those of its digest.
    """
    found = read_json(text, _StoredRecord, name, _unpack)
    if found.trace.digest() != found.digest:
        raise RunDirectoryError(f"{name} does not have its digest")
    return EpisodeRecord(found.spec, found.outcome, found.trace, found.fault)


def _pack(array: NDArray[Any]) -> _StoredArray:
    data = base64.b64encode(zlib.compress(np.ascontiguousarray(array).tobytes(), 6))
    return _StoredArray(array.dtype.str, array.shape, data.decode())


def _unpack(_kind: type, value: object) -> NDArray[Any]:
    """Unpack an array of the size that it declares.

    Raises:
        ValueError: it is no array, larger than any of an episode, or does not have that size.
    """
    stored = convert(value, _StoredArray)
    if stored.dtype not in DTYPES or min(stored.shape, default=-1) < 0:
        raise ValueError("it has an array of another kind")
    dtype = np.dtype(stored.dtype)
    size = math.prod(stored.shape) * dtype.itemsize
    if size > MAX_ARRAY:
        raise ValueError(f"it declares an array of {size} bytes")
    try:
        packed = base64.b64decode(stored.data, validate=True)
        content = zlib.decompressobj().decompress(packed, size + 1)
    except (ValueError, zlib.error) as error:
        raise ValueError(f"it is damaged: {error}") from error
    if len(content) != size:
        raise ValueError("an array does not have the size that it declares")
    return np.frombuffer(content, dtype).reshape(stored.shape).copy()
