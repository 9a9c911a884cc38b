"""Generated files that PyBullet must read from disk, each named by the hash of its content.

The simulator keeps files by name and goes on serving an old geometry when a file changes
under its name; a name that holds the content's hash rules that out.
"""

import hashlib
import os
import tempfile
from collections.abc import Iterable
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
        write_cached(path, content)
    return path


def write_cached(path: Path, content: bytes) -> None:
    """Write a file of the cache in one step: others see the old one or the new, never half.

    Raises:
        InfrastructureError: there is no room, or no permission.
    """
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".new-")
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        raise InfrastructureError(
            f"the cache {path.parent} cannot be written: {error.strerror}; "
            f"set {VARIABLE} to another directory"
        ) from error


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
