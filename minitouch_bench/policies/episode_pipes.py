"""The evaluation's ends of the pipes to one episode's child."""

import os
import select

from minitouch_bench.policies.output_pipe import OutputPipe, wait_for
from minitouch_bench.policies.wire import (
    HEADER,
    MAX_PAYLOAD,
    Frame,
    WireError,
    pack_frame,
    unpack_header,
)


class EpisodePipes:
    """A pipe for requests, one for answers, and one for what the child prints.

    There is one answer to each request, and a deadline for both. The child's process is watched
    as well as its pipe, which one it forked may keep open.
    """

    def __init__(self) -> None:
        self.output = OutputPipe()
        requests, self._requests = os.pipe()
        self._answers, answers = os.pipe()
        self.theirs = (requests, answers, self.output.writer)
        self._buffer = b""
        self._process = -1
        os.set_blocking(self._requests, False)
        os.set_blocking(self._answers, False)

    def hand_over(self) -> None:
        """Close our copies of the child's ends, once they were sent to it."""
        for descriptor in self.theirs[:2]:
            os.close(descriptor)
        self.output.close_writer()

    def watch(self, pid: int) -> None:
        """Note which process is at the other ends; the host reaps it when it is stopped."""
        self._process = os.pidfd_open(pid)

    def ask(self, kind: Frame, payload: bytes, deadline: float) -> tuple[Frame, bytes]:
        """Send a request and return the answer.

        Raises:
            TimeoutError: the request was not read, or not answered, in time.
            EOFError: the child closed its end.
            WireError: no frame of this protocol, or bytes that came before the request.

        """
        if self._buffer or self._read():
            raise WireError("it answered before it was asked")
        self._send(pack_frame(kind, payload), deadline)
        return self.receive(deadline)

    def receive(self, deadline: float) -> tuple[Frame, bytes]:
        """Return the next frame.

        Raises:
            TimeoutError: not in time.
            EOFError: the child closed its end.
            WireError: no frame of this protocol.

        """
        length, kind = unpack_header(self._take(HEADER.size, deadline))
        return kind, self._take(length, deadline)

    def hang_up(self) -> None:
        """Close the pipes but the output's; a child that lives reads the end of its requests."""
        for descriptor in (self._requests, self._answers, self._process):
            if descriptor >= 0:
                os.close(descriptor)
        self._requests = self._answers = self._process = -1

    def close(self) -> None:
        """Close all."""
        self.hang_up()
        self.output.close()

    def _send(self, frame: bytes, deadline: float) -> None:
        rest = memoryview(frame)
        while rest:
            try:
                rest = rest[os.write(self._requests, rest) :]
            except BrokenPipeError:  # the answer's end will tell
                return
            except BlockingIOError:
                ready = wait_for((self._process,), self.output, deadline, (self._requests,))
                if not ready:
                    raise TimeoutError from None
                if _has_ended(self._process):
                    return

    def _take(self, count: int, deadline: float) -> bytes:
        while len(self._buffer) < count:
            if not wait_for((self._answers, self._process), self.output, deadline):
                raise TimeoutError
            if not self._read():
                raise EOFError
        taken, self._buffer = self._buffer[:count], self._buffer[count:]
        return taken

    def _read(self) -> int:
        """Read what answers there are and return their length."""
        try:
            part = os.read(self._answers, MAX_PAYLOAD)
        except BlockingIOError:
            return 0
        self._buffer += part
        return len(part)


def _has_ended(process: int) -> bool:
    return bool(select.select([process], [], [], 0)[0])
