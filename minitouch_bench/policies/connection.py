"""The evaluation's ends: of a policy's host, of what a process prints, of an episode's packets."""

import contextlib
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec

from minitouch_bench.policies import wire
from minitouch_bench.policies.policy import Isolation
from minitouch_bench.policies.sandbox import HOST_SETTINGS, HOST_VARIABLES
from minitouch_bench.processes import watch

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
        plain = (wire.plain_line(line) for line in reversed(lines))
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


def wait_for(readable: Iterable[int], output: OutputPipe, deadline: float) -> bool:
    """Wait for a descriptor until a ``time.monotonic`` deadline, taking output; False if late."""
    poll = select.poll()
    poll.register(output, select.POLLIN)
    for descriptor in readable:
        poll.register(descriptor, select.POLLIN)
    while True:
        left = deadline - time.monotonic()
        if left <= 0:
            return False
        ready = {number for number, _ in poll.poll(left * 1000)}
        if ready - {output.fileno()}:
            return True
        if ready and not output.take():
            poll.unregister(output)


def _packet_pair() -> tuple[socket.socket, socket.socket]:
    """Return two connected sockets that keep the bounds of what is sent."""
    try:
        return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    except OSError:  # macOS: a stream, on which both sides take turns, holds one packet at a time
        pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        for one in pair:
            for size in (socket.SO_SNDBUF, socket.SO_RCVBUF):
                one.setsockopt(socket.SOL_SOCKET, size, 4 * wire.MAX_PAYLOAD)
        return pair


class EpisodeChannel:
    """Packets to and from a watched child, an answer to each request, and the pipe it prints to."""

    def __init__(self) -> None:
        self.output = OutputPipe()
        self._ours, self._theirs = _packet_pair()
        self._ours.setblocking(False)
        self.descriptors = (self._theirs.fileno(), self.output.writer)
        self._process = -1

    def hand_over(self) -> None:
        """Close our copies of the child's ends, once they were sent to it."""
        self._theirs.close()
        self.output.close_writer()

    def watch(self, pid: int) -> None:
        """Note which process is at the other end; the host reaps it when it is stopped."""
        self._process = watch(pid)

    def ask(self, kind: wire.Frame, payload: bytes, deadline: float) -> tuple[wire.Frame, bytes]:
        """Send a request and return the answer.

        Raises:
            TimeoutError: not answered in time.
            EOFError: the child ended, or closed its end.
            WireError: not a packet of this protocol, or one that came before the request.
        """
        if self._take():
            raise wire.WireError("it answered before it was asked")
        with contextlib.suppress(ConnectionError):  # if it has ended, no answer comes
            try:
                self._ours.send(wire.pack_frame(kind, payload))
            except BlockingIOError:
                raise wire.WireError("it does not read its requests") from None
        return self.receive(deadline)

    def receive(self, deadline: float) -> tuple[wire.Frame, bytes]:
        """Return the next packet of the child; raises what ``ask`` does."""
        if not wait_for((self._ours.fileno(), self._process), self.output, deadline):
            raise TimeoutError
        packet = self._take()
        if not packet:
            raise EOFError
        return wire.unpack_frame(packet)

    def hang_up(self) -> None:
        """Close all but the output; a child that lives reads the end of its requests."""
        self._ours.close()
        if self._process >= 0:
            os.close(self._process)
            self._process = -1

    def close(self) -> None:
        """Close all."""
        self.hang_up()
        self.output.close()

    def _take(self) -> bytes:
        """Return the packet that is there, empty where there is none or no more can come."""
        try:
            packet, _, flags, _ = self._ours.recvmsg(1 + wire.MAX_PAYLOAD)
        except (BlockingIOError, ConnectionError):
            return b""
        if flags & socket.MSG_TRUNC:
            raise wire.WireError(f"a packet of more than {wire.MAX_PAYLOAD} bytes")
        return packet


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
    """A running host; the kernel kills it when the thread that made it ends."""

    def __init__(self, isolation: Isolation) -> None:
        ours, theirs = _packet_pair()
        self._output = OutputPipe()
        self._control = ours
        self._in_order = False
        command = [sys.executable, "-P", "-u", "-m", "minitouch_bench.policies.forkserver"]
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
        self, order: wire.Order, timeout_s: float, descriptors: Sequence[int] = ()
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
            socket.send_fds(self._control, [msgspec.json.encode(order)], descriptors)
            deadline = time.monotonic() + timeout_s
            if not wait_for((self._control.fileno(),), self._output, deadline):
                raise HostGoneError(f"no answer within {timeout_s:g} s")
            packet = self._control.recv(wire.MAX_PAYLOAD)
        except OSError as error:
            raise HostGoneError(str(error)) from error
        if not packet:
            raise HostGoneError("it ended")
        self._in_order = False
        answer: dict[str, Any] = msgspec.json.decode(packet)
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
