"""What a process prints, drained so that it never waits; only the end is kept."""

import os
import select
import time
from collections.abc import Iterable

from minitouch_bench.policies.wire import plain_line

KEPT_OUTPUT = 4096
"""Bytes kept of what a process prints, the last ones."""

DRAIN_CHUNK = 64 * 1024
MAX_DRAIN = 2**20
"""Most bytes taken at once from a process that never stops printing."""


class OutputPipe:
    """The reading end of a pipe that is a process's standard output and standard error."""

    def __init__(self) -> None:
        self._reader, self.writer = os.pipe()
        os.set_blocking(self._reader, False)
        self._tail = b""

    def fileno(self) -> int:
        """Return the descriptor to read from."""
        return self._reader

    def take(self) -> int:
        """Read what there is to read, keep its end and return its length; 0 at the end."""
        try:
            part = os.read(self._reader, DRAIN_CHUNK)
        except BlockingIOError:
            return 0
        self._tail = (self._tail + part)[-KEPT_OUTPUT:]
        return len(part)

    def last_line(self) -> str:
        """Return the last line that was printed, made plain."""
        taken = 0
        while taken < MAX_DRAIN and (count := self.take()):
            taken += count
        lines = self._tail.decode(errors="replace").splitlines()
        plain = (plain_line(line) for line in reversed(lines))
        return next((line for line in plain if line), "")

    def close_writer(self) -> None:
        """Close our copy of the writing end, once the process has its own."""
        if self.writer >= 0:
            os.close(self.writer)
            self.writer = -1

    def close(self) -> None:
        """Close both ends."""
        self.close_writer()
        os.close(self._reader)


def wait_for(
    readable: Iterable[int], output: OutputPipe, deadline: float, writable: Iterable[int] = ()
) -> bool:
    """Wait until a descriptor is ready, taking up output meanwhile; return False at the deadline.

    ``deadline`` is a time of ``time.monotonic``, in s.
    """
    poll = select.poll()
    poll.register(output, select.POLLIN)
    for descriptor in readable:
        poll.register(descriptor, select.POLLIN)
    for descriptor in writable:
        poll.register(descriptor, select.POLLOUT)
    while True:
        left = deadline - time.monotonic()
        if left <= 0:
            return False
        ready = {number for number, _ in poll.poll(left * 1000)}
        if ready - {output.fileno()}:
            return True
        if ready and not output.take():
            poll.unregister(output)
