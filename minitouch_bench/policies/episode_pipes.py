"""The evaluation's ends of the two pipes to one episode's child."""

import contextlib
import os

from minitouch_bench.policies.host_connection import HostConnection
from minitouch_bench.policies.wire import HEADER, MAX_PAYLOAD, Frame, unpack_header


class EpisodePipes:
    """A pipe for requests and a pipe for answers; each frame has a deadline.

    The child's process is watched as well as its pipe, which one it forked may keep open.
    """

    def __init__(self, host: HostConnection, requests: int, answers: int) -> None:
        self._host = host
        self._requests = requests
        self._answers = answers
        self._buffer = b""
        self._process = -1
        os.set_blocking(answers, False)

    def watch(self, pid: int) -> None:
        """Note which process is at the other ends; the host reaps it when it is stopped."""
        self._process = os.pidfd_open(pid)

    def send(self, frame: bytes) -> None:
        """Send a frame. It fits into the pipe's buffer: an unread one never comes first."""
        with contextlib.suppress(BrokenPipeError):  # the answer's end will tell
            os.write(self._requests, frame)

    def receive(self, deadline: float) -> tuple[Frame, bytes]:
        """Return the next frame.

        Raises:
            TimeoutError: not in time.
            EOFError: the child closed its end.
            WireError: no frame of this protocol.

        """
        length, kind = unpack_header(self._take(HEADER.size, deadline))
        return kind, self._take(length, deadline)

    def close(self) -> None:
        """Close both ends; a child that lives reads the end of its requests."""
        for descriptor in (self._requests, self._answers, self._process):
            if descriptor >= 0:
                os.close(descriptor)

    def _take(self, count: int, deadline: float) -> bytes:
        while len(self._buffer) < count:
            if not self._host.wait((self._answers, self._process), deadline):
                raise TimeoutError
            try:
                part = os.read(self._answers, MAX_PAYLOAD)
            except BlockingIOError:  # nothing to read, so it was the process that ended
                raise EOFError from None
            if not part:
                raise EOFError
            self._buffer += part
        taken, self._buffer = self._buffer[:count], self._buffer[count:]
        return taken
