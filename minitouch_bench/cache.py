"""Generated files that PyBullet must read from disk, each named by the hash of its content.

The simulator keeps files by name and goes on serving an old geometry when a file changes
under its name; a name that holds the content's hash rules that out.
"""

import hashlib
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path


def cache_directory() -> Path:
    """Return the directory of generated files: ``$MINITOUCH_CACHE`` or the user's cache."""
    chosen = os.environ.get("MINITOUCH_CACHE")
    if chosen:
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "minitouch-bench"


def materialise(stem: str, suffix: str, content: bytes) -> Path:
    """Return the path of a file that holds ``content``, writing it if it is not there.

    Safe when several processes ask at once, and a file of a wrong size is written again.
    """
    digest = hashlib.sha256(content).hexdigest()[:16]
    path = cache_directory() / f"{stem}-{digest}{suffix}"
    if path.is_file() and path.stat().st_size == len(content):
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent)
    with os.fdopen(handle, "wb") as file:
        file.write(content)
    Path(temporary).replace(path)
    return path


def content_digest(paths: Iterable[Path]) -> str:
    """Return a short hash over the bytes of several files."""
    sha = hashlib.sha256()
    for path in paths:
        sha.update(hashlib.sha256(path.read_bytes()).digest())
    return sha.hexdigest()[:16]
