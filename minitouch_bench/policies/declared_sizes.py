"""What a checkpoint says it unpacks to, looked at before anything is unpacked.

A declaration can lie; the sandbox's limit of memory holds those that do.
"""

import io
import zipfile

from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.policies.sources import MAX_FILE_BYTES

MAX_RATIO = 100
"""Weights hardly shrink, and torch stores them unpacked."""

MAX_MEMBERS = 10_000


def check_zip(content: bytes, target: str) -> None:
    """Refuse a zip that unpacks to far more than it holds; leave damaged ones to their reader.

    Raises:
        PolicyLoadError: saying by how much.

    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
    except (zipfile.BadZipFile, ValueError, NotImplementedError):
        return
    if len(members) > MAX_MEMBERS:
        raise PolicyLoadError(f"{target} holds {len(members)} files; the limit is {MAX_MEMBERS}")
    check_bytes(sum(member.file_size for member in members), len(content), target)


def check_bytes(declared: int, held: int, target: str) -> None:
    """Refuse a file of ``held`` bytes that declares too many.

    Raises:
        PolicyLoadError: saying how many.

    """
    if declared > min(MAX_FILE_BYTES, MAX_RATIO * held):
        raise PolicyLoadError(
            f"{target} has {held} bytes and declares {declared}: it is not unpacked"
        )
