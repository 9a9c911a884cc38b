"""The actions that a policy has given in an episode: another attempt must give them again.

An attempt can fail for no fault of the policy: its process is killed, its worker dies, the run is
interrupted. A policy could use another attempt for another try. So each action is in a file
before it is applied, and stays there until the episode's record is in the journal.
"""

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.errors import PolicyFaultError
from minitouch_bench.files import MIB, open_plain, read_file

NOT_REPEATED = "tried again, it did not repeat its actions"


class GivenActions:
    """The longest sequence of actions that any attempt at an episode gave.

    ``path`` names its file; None: only the attempts of this process are known.
    """

    def __init__(self, size: int, path: Path | None = None) -> None:
        self._given: list[bytes] = []
        self._count = 0
        self._file = -1
        if path is None:
            return
        self._file = open_plain(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        row = size * np.dtype(np.float32).itemsize
        content = read_file(path, MIB)
        whole = len(content) - len(content) % row  # a full disk can cut the last one short
        os.ftruncate(self._file, whole)
        self._given = [content[at : at + row] for at in range(0, whole, row)]

    def __enter__(self) -> "GivenActions":
        return self

    def __exit__(self, *_: object) -> None:
        if self._file >= 0:
            os.close(self._file)

    def begin_attempt(self) -> None:
        """Expect the first action again."""
        self._count = 0

    def add(self, action: NDArray[np.float32]) -> None:
        """Note the next action.

        Raises:
            PolicyFaultError: an earlier attempt gave another one here.
            OSError: the disk is full.
        """
        row = np.asarray(action, "<f4").tobytes()
        if self._count == len(self._given):
            if self._file >= 0:
                os.write(self._file, row)
            self._given.append(row)
        elif row != self._given[self._count]:
            raise PolicyFaultError(NOT_REPEATED)
        self._count += 1


def given_path(folder: Path, key: str) -> Path:
    """Return where the actions of an episode are, by its key, as ``pushing-17``."""
    return folder / key.replace("/", "-")
