"""Files: what a run's are called, how large they may be, and the one way to lock, write and read.

A writer never leaves a part of a file, and never writes through a link. A reader opens plain
files only, follows no link unless told to, and looks at the size before it reads.
"""

import errno
import fcntl
import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from minitouch_bench.errors import MiniTouchError, RunDirectoryError

KIB, MIB, GIB = 2**10, 2**20, 2**30

JOURNAL_FILE = "journal.jsonl"
ACTIONS_FILE = "actions.npz"
RUN_FILE = "run.json"
EPISODES_FILE = "episodes.csv"
EXPLORATION_FILE = "exploration.csv"
TABLE4_FILE = "table4.csv"
GENERALIZATION_FILE = "generalization.csv"
REPORT_FILE = "report.md"
REPORT_PAGE = "report.html"
VIDEOS = "videos"
ATTEMPTS = "attempts"
"""Folder of what is known of episodes that have no record yet; a finished run has none."""

RUN_FILES = (
    JOURNAL_FILE, ACTIONS_FILE, RUN_FILE, EPISODES_FILE, EXPLORATION_FILE, TABLE4_FILE,
    GENERALIZATION_FILE, REPORT_FILE, REPORT_PAGE,
)  # fmt: skip
"""What a run writes, beside ``videos/``."""

RUN_ENTRIES = frozenset({*RUN_FILES, VIDEOS, ATTEMPTS})
"""All that a run has in its directory."""

LARGEST_RUN_FILE = 16 * GIB
"""No file of a run is larger; a submission's limits are far below."""

LOCK_FILE = ".lock"
PARTIAL_PATTERN = f".{'[0-9a-f]' * 16}.partial"
"""Names of files that are being written, until they get their own."""


def holds_run(directory: Path) -> bool:
    """Tell whether a run was started in this directory."""
    return any((directory / name).exists() for name in (JOURNAL_FILE, RUN_FILE))


def clear_run(directory: Path) -> None:
    """Remove a run's files and folders, and nothing else."""
    for name in RUN_FILES:
        (directory / name).unlink(missing_ok=True)
    for name in (VIDEOS, ATTEMPTS):
        shutil.rmtree(directory / name, ignore_errors=True)


@contextmanager
def os_errors_as(
    kind: type[MiniTouchError], path: Path, action: str, hint: str = ""
) -> Iterator[None]:
    """Raise an ``OSError`` of the block as an error that says "PATH cannot be ACTION: why"."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise kind(f"{path} cannot be {action}: {reason}{hint}") from error


@contextmanager
def lock_directory(directory: Path) -> Iterator[None]:
    """Create the directory if need be, and hold it alone; the lock ends with the process.

    What a killed holder had half written there is removed.

    Raises:
        RunDirectoryError: it cannot be written, or another process holds it.
    """
    lock = directory / LOCK_FILE
    with os_errors_as(RunDirectoryError, directory, "written"):
        directory.mkdir(parents=True, exist_ok=True)
        handle = _lock(lock)
        for partial in directory.glob(PARTIAL_PATTERN):
            partial.unlink(missing_ok=True)
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(handle)


def _lock(path: Path) -> int:
    """Return the descriptor of a lock file that is held and still has its name."""
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        with ExitStack() as stack:
            stack.callback(os.close, handle)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise RunDirectoryError(
                    f"{path.parent} is in use by another process; choose another --output"
                ) from error
            with suppress(FileNotFoundError):  # its last holder may have removed it meanwhile
                if os.path.samestat(os.fstat(handle), os.lstat(path)):
                    stack.pop_all()
                    return handle


def write_file(path: Path, content: bytes | str, *, durable: bool = True) -> None:
    """Write a whole file, and its directory if need be; a text in UTF-8.

    One that is not ``durable`` may be lost with the machine's power, and is written sooner.

    Raises:
        RunDirectoryError: it cannot be written.
    """
    with os_errors_as(RunDirectoryError, path, "written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        text = content.encode() if isinstance(content, str) else content
        replace_file(path, text, durable=durable)


def replace_file(path: Path, content: bytes, *, durable: bool = True) -> None:
    """Write a file in one step: others see the old one or the new one, never a part.

    A device or a pipe cannot be replaced and is written to.

    Raises:
        OSError: there is no room, or no permission.
    """
    if path.parent == Path("/dev") or (path.exists() and not path.is_file()):
        path.write_bytes(content)
        return
    partial = path.with_name(f".{secrets.token_hex(8)}.partial")
    handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def append_text(path: Path, text: str) -> None:
    """Add a text to the end of a file that others write to as well.

    Raises:
        RunDirectoryError: it cannot be written.
    """
    with os_errors_as(RunDirectoryError, path, "written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8", newline="\n") as file:
            file.write(text)


def read_file(path: Path, limit: int = LARGEST_RUN_FILE, *, follow: bool = False) -> bytes:
    """Return the bytes of a plain file of at most ``limit`` bytes; ``follow`` allows a link.

    Raises:
        OSError: it is missing, cannot be read, is larger, or is no plain file.
    """
    flags = os.O_RDONLY | os.O_NONBLOCK | (0 if follow else os.O_NOFOLLOW)
    try:
        with open(path, "rb", opener=lambda name, _: os.open(name, flags)) as file:
            found = os.fstat(file.fileno())
            if not stat.S_ISREG(found.st_mode):
                raise OSError(errno.EINVAL, "it is no plain file")
            content = file.read(min(found.st_size, limit) + 1)
    except OSError as error:
        if error.errno == errno.ELOOP and path.is_symlink():
            raise OSError(errno.ELOOP, "it is a symbolic link") from error
        raise
    if len(content) > limit:
        raise OSError(errno.EFBIG, f"it is larger than {_amount(limit)}")
    return content


def _amount(size: int) -> str:
    for unit, name in ((GIB, "GiB"), (MIB, "MiB"), (KIB, "KiB")):
        if size % unit == 0:
            return f"{size // unit} {name}"
    return f"{size} bytes"
