"""The cache of OBJ and URDF files: written once, verified on every use, safe for many processes."""

import hashlib
from collections.abc import Callable
from pathlib import Path

from minitouch_bench.cache import cache_directory, cache_errors, replace_file
from minitouch_bench.errors import UsageError
from minitouch_bench.shapegen.files import body_files, file_names
from minitouch_bench.shapegen.record import Body


def materialised(record_digest: str, files_sha256: str, body: Callable[[], Body]) -> Path:
    """Return the path of a shape's URDF in the cache, with its meshes beside it.

    The files are read and hashed each time (0.1 ms), so a damaged one is never used: it is
    written again from ``body()``.

    Raises:
        UsageError: the shape's record does not give the files the manifest promises.
        InfrastructureError: the cache cannot be written.
    """
    names = file_names(record_digest)
    folder = cache_directory() / "shapes" / record_digest[:2]
    if _hash_of(folder, names) != files_sha256:
        files = body_files(body())
        if files.sha256 != files_sha256:
            raise UsageError(
                f"shape {record_digest[:20]}: its files differ from the manifest's; "
                "the set was made by another version of minitouch-bench"
            )
        with cache_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            for name in names:
                replace_file(folder / name, files.contents[name])
    return folder / names[1]


def _hash_of(folder: Path, names: tuple[str, ...]) -> str:
    """Return the digest over files in the order of their names, "" if one is missing."""
    sha = hashlib.sha256()
    try:
        for name in sorted(names):
            sha.update((folder / name).read_bytes())
    except OSError:
        return ""
    return sha.hexdigest()
