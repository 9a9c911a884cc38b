"""The cache of OBJ and URDF files: written once, verified on every use, safe for many processes."""

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from minitouch_bench.errors import InfrastructureError, UsageError
from minitouch_bench.shapegen.files import body_files, file_names
from minitouch_bench.shapegen.record import Body

VARIABLE = "MINITOUCH_CACHE"
"""Environment variable that names another folder for the cache."""


def cache_folder() -> Path:
    """Return the folder of the cache: MINITOUCH_CACHE, or the user's cache folder."""
    if os.environ.get(VARIABLE):
        return Path(os.environ[VARIABLE]).absolute() / "shapes"
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base).absolute() / "minitouch-bench" / "shapes"


def materialised(record_digest: str, files_sha256: str, body: Callable[[], Body]) -> Path:
    """Return the path of a shape's URDF in the cache, with its meshes beside it.

    The files are read and hashed each time (0.1 ms), so a damaged one is never used: it is
    written again from ``body()``.

    Raises:
        UsageError: the shape's record does not give the files the manifest promises.
        InfrastructureError: the cache cannot be written.
    """
    names = file_names(record_digest)
    folder = cache_folder() / record_digest[:2]
    if _hash_of(folder, names) != files_sha256:
        files = body_files(body())
        if files.sha256 != files_sha256:
            raise UsageError(
                f"shape {record_digest[:20]}: its files differ from the manifest's; "
                "the set was made by another version of minitouch-bench"
            )
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name in names:
                replace_file(folder / name, files.contents[name])
        except OSError as error:
            raise InfrastructureError(
                f"the shape cache {folder} cannot be written: {error.strerror}; "
                f"set {VARIABLE} to another folder"
            ) from error
    return folder / names[1]


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


def _hash_of(folder: Path, names: tuple[str, ...]) -> str:
    """Return the digest over files in the order of their names, "" if one is missing."""
    sha = hashlib.sha256()
    try:
        for name in sorted(names):
            sha.update((folder / name).read_bytes())
    except OSError:
        return ""
    return sha.hexdigest()
