"""The evaluation's end of a policy host: start it and give it orders."""

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

from minitouch_bench.policies.isolation.confinement import HOST_VARIABLES
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.policies.pipes import OutputPipe, wait_for
from minitouch_bench.policies.wire import MAX_PAYLOAD
from minitouch_bench.processes import ARITHMETIC

CLOSE_S = 2.0
"""Time in which a host must end by itself once its orders have ended."""

HOST_SETTINGS = {
    **ARITHMETIC,
    "ORT_DISABLE_TELEMETRY": "1",
    "PYTHONHASHSEED": "0",
}
"""Environment of a host: no thread may exist before it forks, and no set may iterate by chance.

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
