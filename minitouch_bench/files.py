"""Files: what a run's are called, how large they may be, and the one way to lock, write and read.

A writer never leaves a part of a file, and never writes through a link. A reader opens plain
files only, follows no link unless told to, and looks at the size before it reads. So a run that a
stranger made can be read and written to as one's own.

The cache has generated files that PyBullet must read from disk, each named by the hash of its
content: the simulator keeps files by name and would serve an old geometry under the same name.
"""

import errno
import fcntl
import hashlib
import logging
import os
import re
import secrets
import stat
import zlib
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path

from minitouch_bench import errors
from minitouch_bench.text import printable

KIB, MIB, GIB = 2**10, 2**20, 2**30

ACTIONS_FILE, RUN_FILE = "actions.npz", "run.json"
PACKED_RUN_FILE = "run.json.gz"
"""The facts of a run that is kept without its actions, as a row of the leaderboard is."""
EPISODES_FILE, REPORT_PAGE = "episodes.csv", "report.html"
PROGRESS_FILE = "progress.csv"
"""A training's curves: a row per some hundred control steps."""
VIDEOS, REPLAYS = "videos", "replays"
"""Folders of a run for what people look at."""
SUBMISSION_FILE, CHECKPOINTS = "submission.toml", "checkpoints"

REPORTS, SUBMISSIONS = Path("reports"), Path("submissions")
"""Where runs, reports and submissions without ``output`` get a directory of their own."""
RESULTS = REPORTS / "results"
"""Directory of the rows that were played, one folder each."""
JOURNAL_FILE = "run.journal"
"""What is done of a run; a finished run has none."""

RUN_FILES = (ACTIONS_FILE, RUN_FILE, JOURNAL_FILE, EPISODES_FILE, REPORT_PAGE)
"""What a run writes, beside its videos and replays."""

VIEW_NAME = re.compile(r"(exploration-)?[a-z][a-z0-9-]*-\d+\.(mp4|gif|html|csv)")
"""What a run's videos and replays are called."""

RUN_ENTRIES = frozenset({*RUN_FILES, VIDEOS, REPLAYS})
"""All that a run has in its directory."""

LARGEST_FILE = 64 * MIB
"""The most that is read of a file at once, where no other limit is given."""

ENTRY_MARK = b"PK\x01\x02"
"""What each entry of a ZIP file's list begins with."""

LARGEST_CHECKPOINT = GIB
"""The most bytes of a checkpoint, given as a file, inside an archive, or by a hub."""

LARGEST_ACTIONS = 256 * MIB
"""The most bytes of ``actions.npz``."""

MAX_EPISODES = 10_000
"""The most per task: the ``run.json`` of a larger run would be more than a reader takes."""

LOCK_FILE = ".lock"
PARTIAL_PATTERN = f".{'[0-9a-f]' * 16}.partial"
"""Names of files that are being written, until they get their own."""
NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP)
"""Error numbers of a file system without locks, such as those of some clusters."""


def holds_run(directory: Path) -> bool:
    """Tell whether a run was started in this directory."""
    return any(os.path.lexists(directory / name) for name in (JOURNAL_FILE, RUN_FILE))


def entries_of(directory: Path) -> list[str]:
    """Return the names of all that lies in a directory, except its lock; none where it is missing.

    Raises:
        RunDirectoryError: it cannot be read.
    """
    with os_errors_as(errors.RunDirectoryError, directory, "read"), suppress(FileNotFoundError):
        return sorted(name for name in os.listdir(directory) if name != LOCK_FILE)
    return []


def refuse_entries(directory: Path, entries: Iterable[str], advice: str) -> None:
    """Refuse a directory with such ``entries``, which a command would mix with its own.

    Raises:
        RunDirectoryError: there is one; ``advice`` says what to do.
    """
    if found := sorted(entries):
        raise errors.RunDirectoryError(f"{directory} is not empty: {found[0]!a}.\n{advice}")


def clear_run(directory: Path) -> None:
    """Remove the files of a run, and its folders of views where nothing else is in them.

    Raises:
        RunDirectoryError: one of them cannot be removed.
    """
    with os_errors_as(errors.RunDirectoryError, directory, "cleared"):
        for name in RUN_FILES:
            (directory / name).unlink(missing_ok=True)
        for folder in filter(is_folder, (directory / VIDEOS, directory / REPLAYS)):
            for name in filter(VIEW_NAME.fullmatch, os.listdir(folder)):
                (folder / name).unlink()
            with suppress(OSError):  # something else is in it
                folder.rmdir()


def view_name(key: str, suffix: str) -> str:
    """Return the file name of a view of an episode, as ``pushing-17.html``."""
    return key.replace("/", "-") + suffix


@contextmanager
def os_errors_as(
    kind: type[errors.MiniTouchError], path: Path, action: str, hint: str = ""
) -> Iterator[None]:
    """Raise an ``OSError`` of the block as an error that says "PATH cannot be ACTION: why"."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise kind(f"{path} cannot be {action}: {reason}{hint}") from error


@contextmanager
def damage_as(kind: type[errors.MiniTouchError], what: str) -> Iterator[None]:
    """Raise what reading a damaged file causes in a block as an error that says "WHAT: why"."""
    try:
        yield
    except (errors.MiniTouchError, ImportError, MemoryError):
        raise
    except Exception as error:  # what torch, zipfile, pickle, numpy and Minari raise has no root
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise kind(f"{what}: {reason}") from error


@contextmanager
def lock_directory(directory: Path, *, wait: bool = False) -> Iterator[None]:
    """Create the directory if need be, and hold it alone; the lock ends with the process.

    What a killed holder had half written there is removed; at the end, so is a directory that is
    new and still empty. ``wait`` until no other process has it. Where the file system has no
    locks, a note says so, and others are not kept out.

    Raises:
        RunDirectoryError: it cannot be written, or another process holds it.
    """
    lock = directory / LOCK_FILE
    with os_errors_as(errors.RunDirectoryError, directory, "written"):
        handle, is_new = _lock(lock, wait=wait)
    try:
        with os_errors_as(errors.RunDirectoryError, directory, "written"):
            for place in filter(is_folder, (directory, directory / VIDEOS, directory / REPLAYS)):
                for partial in place.glob(PARTIAL_PATTERN):
                    partial.unlink(missing_ok=True)
        yield
    finally:
        with suppress(FileNotFoundError):  # the directory may have been moved or removed
            if os.path.samestat(os.fstat(handle), os.lstat(lock)):
                lock.unlink()
        os.close(handle)
        if is_new:
            with suppress(OSError):  # it is not empty
                directory.rmdir()


def _lock(path: Path, *, wait: bool) -> tuple[int, bool]:
    """Return the descriptor of a held lock file, and whether its directory was made for it."""
    while True:
        is_new = not path.parent.exists()
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = open_plain(path, os.O_RDWR | os.O_CREAT)
        with ExitStack() as stack:
            stack.callback(os.close, handle)
            if os.fstat(handle).st_size:
                raise OSError(errno.EEXIST, f"its file {LOCK_FILE} is not a run's")
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except BlockingIOError as error:
                text = f"{path.parent} is in use by another process; choose another directory"
                raise errors.RunDirectoryError(text) from error
            except OSError as error:
                if error.errno not in NO_LOCKS:
                    raise
                logging.getLogger(__name__).warning(
                    "%s: this file system has no locks (%s), so nothing stops a second command in "
                    "the same directory: start only one",
                    printable(str(path.parent)),
                    error.strerror,
                )
            with suppress(FileNotFoundError):  # its last holder may have removed it meanwhile
                if os.path.samestat(os.fstat(handle), os.lstat(path)):
                    stack.pop_all()
                    return handle, is_new


def write_file(path: Path, content: bytes | str, *, durable: bool = True) -> None:
    """Write a whole file, and its directory if need be; a text in UTF-8.

    One that is not ``durable`` may be lost with the machine's power, and is written sooner.

    Raises:
        RunDirectoryError: it cannot be written.
    """
    with os_errors_as(errors.RunDirectoryError, path, "written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        text = content.encode() if isinstance(content, str) else content
        replace_file(path, text, durable=durable)


def replace_file(path: Path, content: bytes, *, durable: bool = True) -> None:
    """Write a file in one step: others see the old one or the new one, never a part.

    A link is replaced, its target is not touched. A device below ``/dev`` is written to: only
    the user can have meant it. ``/dev/shm`` holds plain files.

    Raises:
        OSError: the disk is full, permission is missing, or the path is not a plain file.
    """
    if Path("/dev") in path.parents and Path("/dev/shm") not in path.parents:
        path.write_bytes(content)
        return
    if not path.is_symlink() and path.exists():
        _check_plain(path.stat())
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


def append_bytes(path: Path, content: bytes) -> None:
    """Add to the end of a plain file that has no other name, and create it if need be.

    It survives a loss of the machine's power.

    Raises:
        RunDirectoryError: it cannot be written, or is something else.
    """
    with os_errors_as(errors.RunDirectoryError, path, "written"):
        handle = open_plain(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
        with os.fdopen(handle, "ab") as file:
            file.write(content)
            file.flush()
            os.fsync(handle)


def make_folder(path: Path) -> Path:
    """Create a folder if need be, and return it; one that is a link is refused.

    A run's own folders are made so: what is written into them stays in the run's directory.

    Raises:
        RunDirectoryError: it cannot be made, or is no directory.
    """
    with os_errors_as(errors.RunDirectoryError, path, "written"):
        with suppress(FileExistsError):
            path.mkdir(parents=True)
        if not is_folder(path):
            raise OSError(errno.ENOTDIR, "it is no directory")
    return path


def is_folder(path: Path) -> bool:
    """Tell whether this is a directory itself, not a link to one."""
    return os.path.isdir(path) and not os.path.islink(path)


def list_videos(directory: Path) -> list[Path]:
    """Return the videos of a run, plain files in its own folder, by name."""
    folder = directory / VIDEOS
    if not is_folder(folder):
        return []
    with os_errors_as(errors.UnreadableFileError, folder, "read"):
        videos = [path for path in sorted(folder.iterdir()) if path.suffix == ".mp4"]
    return [path for path in videos if path.is_file() and not path.is_symlink()]


def open_plain(path: Path, flags: int, *, follow: bool = False) -> int:
    """Open a plain file and return its descriptor; ``follow`` allows a link to it.

    A pipe does not make the caller wait. A file that has another name elsewhere is not opened to
    be written.

    Raises:
        OSError: it is missing, cannot be opened, or is no plain file.
    """
    flags |= os.O_NONBLOCK | os.O_CLOEXEC | (0 if follow else os.O_NOFOLLOW)
    try:
        handle = os.open(path, flags, 0o666)
    except OSError as error:
        if error.errno == errno.ELOOP and path.is_symlink():
            raise OSError(errno.ELOOP, "it is a symbolic link") from error
        raise
    with ExitStack() as stack:
        stack.callback(os.close, handle)
        found = os.fstat(handle)
        _check_plain(found)
        if flags & os.O_ACCMODE != os.O_RDONLY and found.st_nlink > 1:
            raise OSError(errno.EMLINK, "it has another name elsewhere")
        stack.pop_all()
    return handle


def _check_plain(found: os.stat_result) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "it is no plain file")


LFS_POINTER = b"version https://git-lfs.github.com/"


def read_file(path: Path, limit: int = LARGEST_FILE, *, follow: bool = False) -> bytes:
    """Return the bytes of a plain file of at most ``limit`` bytes; ``follow`` allows a link.

    Raises:
        OSError: it is missing, cannot be read, is larger, or is no plain file.
    """
    with os.fdopen(open_plain(path, os.O_RDONLY, follow=follow), "rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > limit:
            most = f"{limit // MIB} MiB" if limit >= MIB else f"{limit // KIB} KiB"
            raise OSError(errno.EFBIG, f"it is larger than {most}")
        content = file.read(size)
    if content.startswith(LFS_POINTER):
        raise OSError(errno.ENODATA, "it is a pointer of Git LFS, not the file; run git lfs pull")
    return content


def unpack(packed: bytes) -> bytes:
    """Return what a ``.gz`` file contains, at most LARGEST_FILE bytes.

    Raises:
        zlib.error: it is damaged, cut short, or larger.
    """
    unpacking = zlib.decompressobj(wbits=zlib.MAX_WBITS | 16)
    content = unpacking.decompress(packed, LARGEST_FILE)
    if not unpacking.eof:
        most = LARGEST_FILE // MIB
        raise zlib.error(f"it is cut short, or larger than {most} MiB when it is unpacked")
    return content


VARIABLE = "MINITOUCH_CACHE"
"""Environment variable that names another directory for generated files."""


def cache_directory() -> Path:
    """Return the directory of generated files: ``$MINITOUCH_CACHE`` or the user's cache.

    Raises:
        InfrastructureError: the user has no home directory, as in some containers.
    """
    if chosen := os.environ.get(VARIABLE):
        return Path(os.path.expanduser(chosen)).absolute()
    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError as error:
        text = (
            f"generated files cannot be written: no home directory; set {VARIABLE} to a directory"
        )
        raise errors.InfrastructureError(text) from error
    return Path(base).absolute() / "minitouch-bench"


def cache_file(stem: str, suffix: str, content: bytes) -> Path:
    """Return the path of a file that holds ``content``, writing it if it is not there.

    Raises:
        InfrastructureError: the cache cannot be written.
    """
    digest = hashlib.sha256(content).hexdigest()[:16]
    path = cache_directory() / f"{stem}-{digest}{suffix}"
    with suppress(OSError):
        if read_file(path, len(content)) == content:
            return path
    with cache_errors(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, content)
    return path


def cache_errors(directory: Path) -> AbstractContextManager[None]:
    """Raise an ``OSError`` of the block as an ``InfrastructureError`` that names the variable."""
    hint = f"; set {VARIABLE} to another directory"
    return os_errors_as(errors.InfrastructureError, directory, "written", hint)
