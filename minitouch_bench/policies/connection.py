"""The evaluation's ends: of a policy's host, of what a process prints, of an episode's pipes."""

import json
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.policies.isolation.readable import HOST_SETTINGS, HOST_VARIABLES
from minitouch_bench.policies.wire import (
    HEADER,
    MAX_PAYLOAD,
    Frame,
    WireError,
    pack_frame,
    plain_line,
    unpack_header,
)

KEPT_OUTPUT = 4096
"""Bytes kept of what a process prints, the last ones."""

DRAIN_CHUNK = 64 * 1024
MAX_DRAIN = 2**20
"""Most bytes taken at once from a process that never stops printing."""

CLOSE_S = 2.0
"""Time in which a host must end by itself once its orders have ended."""


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


def _environment(isolation: Isolation) -> dict[str, str]:
    """Return a host's environment, in the sandbox without what a policy must not learn."""
    sandboxed = isolation is Isolation.SANDBOX
    kept = {
        name: value for name, value in os.environ.items() if not sandboxed or name in HOST_VARIABLES
    }
    return {**kept, **HOST_SETTINGS}


class HostGoneError(Exception):
    """The host process ended or does not answer."""


class HostConnection:
    """A running host process.

    The kernel kills the host when the thread that made it ends: make it in a lasting thread.
    """

    def __init__(self, isolation: Isolation) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._output = OutputPipe()
        self._control = ours
        self._in_order = False
        command = [sys.executable, "-P", "-u", "-m", "minitouch_bench.policies.host"]
        with theirs:
            self._process = subprocess.Popen(
                [*command, str(theirs.fileno()), str(os.getpid())],
                stdin=subprocess.DEVNULL,
                stdout=self._output.writer,
                stderr=self._output.writer,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,  # Ctrl-C on a terminal is the evaluation's to handle
                env=_environment(isolation),
            )
        self._output.close_writer()

    @property
    def pid(self) -> int:
        """Process id of the host."""
        return self._process.pid

    def order(
        self, order: Mapping[str, Any], timeout_s: float, descriptors: Sequence[int] = ()
    ) -> dict[str, Any]:
        """Send an order, with file descriptors if it has any, and return the answer.

        Raises:
            HostGoneError: the host is gone, or silent for so long, or an earlier order was
                broken off, so that its answer would be taken for this one's.
        """
        if self._in_order:
            raise HostGoneError("an earlier order was broken off")
        self._in_order = True
        try:
            socket.send_fds(self._control, [json.dumps(order).encode()], list(descriptors))
            deadline = time.monotonic() + timeout_s
            if not wait_for((self._control.fileno(),), self._output, deadline):
                raise HostGoneError(f"no answer within {timeout_s:g} s")
            packet = self._control.recv(MAX_PAYLOAD)
        except OSError as error:
            raise HostGoneError(str(error)) from error
        if not packet:
            raise HostGoneError("it ended")
        self._in_order = False
        answer: dict[str, Any] = json.loads(packet)
        return answer

    def last_line(self) -> str:
        """Return the last line the host printed, made plain."""
        return self._output.last_line()

    def close(self) -> None:
        """End the host and every process it forked."""
        self._control.close()
        try:
            self._process.wait(CLOSE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._output.close()
