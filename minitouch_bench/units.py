"""Finished units of a resumable job: an atomic file each, with its SHA-256."""

import hashlib
from pathlib import Path

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.files import MIB, os_errors_as, read_file, replace_file

LARGEST_UNIT = 64 * MIB
_DIGEST_LINE = 65
"""Bytes of the first line: 64 hexadecimal digits and a line break."""


def unit_name(key: str) -> str:
    """Return what the file of an episode is called, by the episode's key, as ``pushing-17``."""
    return key.replace("/", "-")


class Units:
    """The units of one job, in a directory; each has a name that suits a file.

    A unit is written in one step, so a crash leaves it whole or missing. One that does not have
    its digest counts as missing: the job makes it again.
    """

    def __init__(self, directory: Path, ending: str, hint: str = "") -> None:
        self.directory = directory
        self._ending = ending
        self._hint = hint

    def path(self, name: str) -> Path:
        """Return the file of a unit."""
        return self.directory / f"{name}{self._ending}"

    def keep(self, name: str, content: bytes) -> None:
        """Write a unit; it survives whatever happens after this returns.

        Raises:
            InfrastructureError: the disk is full or fails; the other units stay.
        """
        digest = hashlib.sha256(content).hexdigest().encode()
        with os_errors_as(InfrastructureError, self.path(name), "written", self._hint):
            replace_file(self.path(name), digest + b"\n" + content)

    def read(self, name: str) -> bytes | None:
        """Return the content of a unit, None where it is missing or damaged."""
        try:
            content = read_file(self.path(name), LARGEST_UNIT)
        except OSError:
            return None
        digest, content = content[:_DIGEST_LINE], content[_DIGEST_LINE:]
        whole = digest == hashlib.sha256(content).hexdigest().encode() + b"\n"
        return content if whole else None
