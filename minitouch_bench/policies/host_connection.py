"""The evaluation's end of a policy host: start it, give it orders, keep what it prints."""

import json
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from minitouch_bench.policies.isolation.limits import HOST_VARIABLES
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.policies.wire import MAX_PAYLOAD, plain_line
from minitouch_bench.processes import ARITHMETIC

KEPT_OUTPUT = 4096
"""Bytes kept of what the policy prints, the last ones."""

DRAIN_CHUNK = 64 * 1024
MAX_DRAIN = 2**20
"""Most bytes taken at once from a policy that never stops printing."""

CLOSE_S = 2.0
"""Time in which a host must end by itself once its orders have ended."""

HOST_SETTINGS = {
    **ARITHMETIC,
    "ORT_DISABLE_TELEMETRY": "1",
    "PYTHONHASHSEED": "0",
}
"""Environment of a host: no thread may exist before it forks, nor sets iterate by chance.

From 1.29 on, onnxruntime's Linux packages start a thread that reports models to Microsoft.
"""


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
        self._output, output = os.pipe()
        os.set_blocking(self._output, False)
        self._control = ours
        self._in_order = False
        self._tail = b""
        command = [sys.executable, "-P", "-u", "-m", "minitouch_bench.policies.host"]
        with theirs:
            self._process = subprocess.Popen(
                [*command, str(theirs.fileno()), str(os.getpid())],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,  # Ctrl-C on a terminal is the evaluation's to handle
                env=_environment(isolation),
            )
        os.close(output)

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
            if not self.wait((self._control.fileno(),), time.monotonic() + timeout_s):
                raise HostGoneError(f"no answer within {timeout_s:g} s")
            packet = self._control.recv(MAX_PAYLOAD)
        except OSError as error:
            raise HostGoneError(str(error)) from error
        if not packet:
            raise HostGoneError("it ended")
        self._in_order = False
        answer: dict[str, Any] = json.loads(packet)
        return answer

    def wait(self, descriptors: Iterable[int], deadline: float) -> bool:
        """Wait until one can be read, taking up output meanwhile; return False at the deadline.

        ``deadline`` is a time of ``time.monotonic``, in s.
        """
        poll = select.poll()
        for descriptor in (*descriptors, self._output):
            poll.register(descriptor, select.POLLIN)
        while True:
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            ready = {number for number, _ in poll.poll(left * 1000)}
            if ready - {self._output}:
                return True
            if ready and not self._take_output():
                poll.unregister(self._output)

    def last_line(self) -> str:
        """Return the last line the policy printed, made plain."""
        taken = 0
        while taken < MAX_DRAIN and (count := self._take_output()):
            taken += count
        lines = self._tail.decode(errors="replace").splitlines()
        plain = (plain_line(line) for line in reversed(lines))
        return next((line for line in plain if line), "")

    def forget_output(self) -> None:
        """Drop what was printed so far."""
        self.last_line()
        self._tail = b""

    def close(self) -> None:
        """End the host and every process it forked."""
        self._control.close()
        try:
            self._process.wait(CLOSE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._output)

    def _take_output(self) -> int:
        """Read what there is to read, keep its end and return its length; 0 at the end."""
        try:
            part = os.read(self._output, DRAIN_CHUNK)
        except BlockingIOError:
            return 0
        self._tail = (self._tail + part)[-KEPT_OUTPUT:]
        return len(part)
