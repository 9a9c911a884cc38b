"""Generated files that PyBullet must read from disk, each named by the hash of its content.

The simulator keeps files by name and goes on serving an old geometry when a file changes
under its name; a name that holds the content's hash rules that out.
"""

import hashlib
import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from minitouch_bench.errors import InfrastructureError

VARIABLE = "MINITOUCH_CACHE"
"""Environment variable that names another directory for generated files."""


def cache_directory() -> Path:
    """Return the directory of generated files: ``$MINITOUCH_CACHE`` or the user's cache."""
    if chosen := os.environ.get(VARIABLE):
        return Path(chosen).absolute()
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base).absolute() / "minitouch-bench"


def materialise(stem: str, suffix: str, content: bytes) -> Path:
    """Return the path of a file that holds ``content``, writing it if it is not there.

    Raises:
        InfrastructureError: the cache cannot be written.
    """
    digest = hashlib.sha256(content).hexdigest()[:16]
    path = cache_directory() / f"{stem}-{digest}{suffix}"
    if not _holds(path, content):
        with cache_errors(path.parent):
            path.parent.mkdir(parents=True, exist_ok=True)
            replace_file(path, content)
    return path


@contextmanager
def cache_errors(directory: Path) -> Iterator[None]:
    """Turn a failure to write the cache into one that a user understands.

    Raises:
        InfrastructureError: there is no room, or no permission.
    """
    try:
        yield
    except OSError as error:
        raise InfrastructureError(
            f"the cache {directory} cannot be written: {error.strerror}; "
            f"set {VARIABLE} to another directory"
        ) from error


def replace_file(path: Path, content: bytes) -> None:
    """Write a file in one step: other processes see the old one or the new one, never half.

    Raises:
        OSError: there is no room, or no permission.
    """
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".new-")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except OSError:
        Path(temporary).unlink(missing_ok=True)
        raise


def content_digest(paths: Iterable[Path]) -> str:
    """Return a short hash over the bytes of several files."""
    sha = hashlib.sha256()
    for path in paths:
        sha.update(hashlib.sha256(path.read_bytes()).digest())
    return sha.hexdigest()[:16]


def _holds(path: Path, content: bytes) -> bool:
    try:
        return path.read_bytes() == content
    except OSError:
        return False
