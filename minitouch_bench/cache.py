"""Generated files that PyBullet must read from disk, each named by the hash of its content.

The simulator keeps files by name and goes on serving an old geometry when a file changes
under its name; a name that holds the content's hash rules that out.
"""

import hashlib
import os
from contextlib import AbstractContextManager
from pathlib import Path

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.files import os_errors_as, read_file, replace_file

VARIABLE = "MINITOUCH_CACHE"
"""Environment variable that names another directory for generated files."""


def cache_directory() -> Path:
    """Return the directory of generated files: ``$MINITOUCH_CACHE`` or the user's cache."""
    if chosen := os.environ.get(VARIABLE):
        return Path(chosen).absolute()
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base).absolute() / "minitouch-bench"


def cache_file(stem: str, suffix: str, content: bytes) -> Path:
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


def cache_errors(directory: Path) -> AbstractContextManager[None]:
    """Raise an ``OSError`` of the block as an ``InfrastructureError`` that names the variable."""
    hint = f"; set {VARIABLE} to another directory"
    return os_errors_as(InfrastructureError, directory, "written", hint)


def _holds(path: Path, content: bytes) -> bool:
    try:
        return read_file(path, len(content)) == content
    except OSError:
        return False
