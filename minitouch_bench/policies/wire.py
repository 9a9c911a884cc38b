"""Between the evaluation and a policy's process: packets, and the evaluation's ends of them.

Over a Unix socket go observations one way, and packets of a header and a payload the other way.
Nothing is pickled: the trusted side reads numbers and text only.
"""

import contextlib
import io
import os
import select
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from minitouch_bench import errors
from minitouch_bench.episode import Observation
from minitouch_bench.policies import policy
from minitouch_bench.policies.sandbox import HOST_SETTINGS, HOST_VARIABLES
from minitouch_bench.text import plain_line

MAX_PAYLOAD = 64 * 1024
"""Longest payload either side accepts, in bytes."""

IMAGE_BYTES = int(np.prod(policy.IMAGE_SHAPE))
OBSERVATION_BYTES = IMAGE_BYTES + 4 * policy.TOUCH_SHAPE[0]


class HostSetup(msgspec.Struct, frozen=True):
    """What a host has in memory before each episode; ``factory`` has files of its own to read."""

    kind: str
    options: policy.IsolationOptions
    factory: str = ""


class StartOrder(msgspec.Struct, frozen=True):
    """The order to fork a child for an episode of one checkpoint."""

    source: policy.PolicySource
    task: str
    seed: int


class Frame(IntEnum):
    """Kinds of packet from a policy's process: the first three once each, then actions."""

    CONFINED = 1
    """Before a byte of the checkpoint is looked at."""
    LOADED = 2
    """With what the loader warns of."""
    READY = 3
    ACTION = 4
    """To an observation: little-endian float32."""

    REFUSED = 5
    INVALID = 6
    UNREACHABLE = 7
    RAISED = 8


KINDS = frozenset(Frame)

FAILURES: Mapping[Frame, type[errors.MiniTouchError]] = {
    Frame.REFUSED: errors.PolicyLoadError,
    Frame.INVALID: errors.InvalidActionError,
    Frame.UNREACHABLE: errors.ServerUnreachableError,
    Frame.RAISED: errors.PolicyRaisedError,
}
"""What a policy's process sends in place of any other packet, with the error's text, and ends."""


class WireError(Exception):
    """Bytes that are not of this protocol."""


HEADER = struct.Struct("<BI")
"""The kind of a packet, and the length of its payload in bytes."""


def write_frame(channel: int, kind: Frame, payload: bytes = b"") -> None:
    """Write a packet to a socket's descriptor, waiting as long as it takes."""
    payload = payload[:MAX_PAYLOAD]
    os.write(channel, HEADER.pack(kind, len(payload)) + payload)


def pack_observation(observation: Observation) -> bytes:
    """Return the image's 7056 bytes, then the touch vector as 11 little-endian float32."""
    return observation["image"].tobytes() + observation["touch"].astype("<f4", copy=False).tobytes()


def unpack_observation(payload: bytes) -> dict[str, NDArray[Any]]:
    """Return the observation of ``pack_observation``, in arrays that may be written to.

    Raises:
        WireError: another number of bytes.
    """
    if len(payload) != OBSERVATION_BYTES:
        raise WireError(f"an observation of {len(payload)} bytes, not {OBSERVATION_BYTES}")
    image = np.frombuffer(payload, np.uint8, IMAGE_BYTES).reshape(policy.IMAGE_SHAPE)
    touch = np.frombuffer(payload, "<f4", offset=IMAGE_BYTES)
    return {"image": image.copy(), "touch": touch.astype(np.float32)}


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
        reader, writer = os.pipe()
        os.set_blocking(reader, False)
        self._reader, self.writer = io.FileIO(reader), io.FileIO(writer, "wb")
        self._tail = b""

    def fileno(self) -> int:
        """Return the descriptor to read from."""
        return self._reader.fileno()

    def take(self) -> int:
        """Read what there is to read, keep its end and return its length; 0 at the end."""
        part = self._reader.read(DRAIN_CHUNK) or b""  # None where nothing is there yet
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

    def close(self) -> None:
        """Close both ends."""
        self.writer.close()
        self._reader.close()


class RunningClock:
    """Seconds that do not pass while this process is stopped: Ctrl-Z, or a paused container.

    A wait is divided into parts of at most PART_S. If a part ends more than PART_S late, this
    process was stopped, and the delay does not count. So up to two seconds of a stop count.
    """

    PART_S = 1.0

    def __init__(self) -> None:
        self._stopped_s = 0.0

    def now(self) -> float:
        """Return the time in seconds."""
        return time.monotonic() - self._stopped_s

    def poll(self, poll: select.poll, longest_s: float) -> set[int]:
        """Return the descriptors that are ready, after PART_S at most."""
        part_s, began = min(longest_s, self.PART_S), time.monotonic()
        ready = {number for number, _ in poll.poll(part_s * 1000)}
        late_s = time.monotonic() - began - part_s
        if late_s > self.PART_S:
            self._stopped_s += late_s
        return ready


CLOCK = RunningClock()
"""Of all deadlines of policies."""


def wait_for(readable: Iterable[int], output: OutputPipe, deadline: float) -> bool:
    """Wait for a descriptor until a deadline of CLOCK, taking output; False if late."""
    poll = select.poll()
    poll.register(output, select.POLLIN)
    for descriptor in readable:
        poll.register(descriptor, select.POLLIN)
    while (left_s := deadline - CLOCK.now()) > 0:
        ready = CLOCK.poll(poll, left_s)
        if ready - {output.fileno()}:
            return True
        if ready and not output.take():
            poll.unregister(output)
    return False


class EpisodeChannel:
    """Packets to and from a watched child, and the pipe that it prints to."""

    def __init__(self) -> None:
        self.output = OutputPipe()
        self._ours, self._theirs = socket.socketpair()
        self._ours.setblocking(False)
        self._received = b""
        self.descriptors = (self._theirs.fileno(), self.output.writer.fileno())
        self._process = -1

    def hand_over(self) -> None:
        """Close our copies of the child's ends, once they were sent to it."""
        self._theirs.close()
        self.output.writer.close()

    def watch(self, pid: int) -> None:
        """Note which process is at the other end; the host reaps it when it is stopped."""
        with contextlib.suppress(AttributeError, OSError):  # not on macOS nor in every container
            self._process = os.pidfd_open(pid)

    def ask(self, observation: bytes, deadline: float) -> tuple[Frame, bytes]:
        """Send an observation and return the answer; raises what ``receive`` does."""
        if self._received or self._take():
            raise WireError("it answered before it was asked")
        # If it has ended, or reads nothing, no answer comes.
        with contextlib.suppress(ConnectionError, BlockingIOError):
            self._ours.send(observation)
        return self.receive(deadline)

    def receive(self, deadline: float) -> tuple[Frame, bytes]:
        """Return the kind and the payload of the child's next packet.

        Raises:
            TimeoutError: none came in time.
            EOFError: the child ended, or closed its end.
            WireError: not a packet of this protocol, or one that came before the observation.
        """
        while len(self._received) < (end := self._packet_end()):
            ends = (one for one in (self._ours.fileno(), self._process) if one >= 0)
            if not wait_for(ends, self.output, deadline):
                raise TimeoutError
            if not self._take():
                raise EOFError
        packet, self._received = self._received[:end], self._received[end:]
        return Frame(packet[0]), packet[HEADER.size :]

    def hang_up(self) -> None:
        """Close all but the output; a child that lives reads the end of the observations."""
        self._ours.close()
        if self._process >= 0:
            os.close(self._process)
            self._process = -1

    def close(self) -> None:
        """Close all."""
        self.hang_up()
        self.output.close()

    def _packet_end(self) -> int:
        """Return how many bytes the next packet has, or its header while that is not received."""
        if len(self._received) < HEADER.size:
            return HEADER.size
        kind, length = HEADER.unpack_from(self._received)
        if kind not in KINDS or length > MAX_PAYLOAD:
            raise WireError(f"a packet of kind {kind} with {length} bytes")
        return HEADER.size + length

    def _take(self) -> int:
        """Read what is there and return its length, 0 where nothing is or no more can come."""
        part = b""
        with contextlib.suppress(BlockingIOError, ConnectionError):
            part = self._ours.recv(MAX_PAYLOAD)
        self._received += part
        return len(part)


class HostGoneError(Exception):
    """The host process ended or does not answer."""


class HostConnection:
    """A running host; the kernel kills it when the thread that made it ends."""

    def __init__(self, setup: HostSetup) -> None:
        self.setup = setup
        self._control, theirs = socket.socketpair()
        self.output = OutputPipe()
        # In the sandbox a host has nothing in its environment that a policy must not learn.
        is_confined = setup.options.level is policy.Isolation.SANDBOX
        known = HOST_VARIABLES if is_confined else os.environ.keys()
        kept = {name: value for name, value in os.environ.items() if name in known}
        options = ["-P", "-u", *["-s"] * sys.flags.no_user_site]  # packages come from where ours do
        command = [sys.executable, *options, "-m", "minitouch_bench.policies.forkserver"]
        with theirs:
            self.process = subprocess.Popen(
                [*command, str(theirs.fileno()), str(os.getpid()), msgspec.json.encode(setup)],
                stdin=subprocess.DEVNULL,
                stdout=self.output.writer,
                stderr=self.output.writer,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,  # Ctrl-C on a terminal is the evaluation's to handle
                env={**kept, **HOST_SETTINGS},
            )
        self.output.writer.close()

    def order(
        self, order: StartOrder | float, timeout_s: float, descriptors: Sequence[int] = ()
    ) -> dict[str, Any]:
        """Send an order, with file descriptors if it has any, and return the answer.

        A number is the order to end the child, which has so many seconds to exit by itself.

        Raises:
            HostGoneError: the host is gone, or silent for so long: it can take no other order.
        """
        try:
            socket.send_fds(self._control, [msgspec.json.encode(order)], descriptors)
            deadline = CLOCK.now() + timeout_s
            if not wait_for((self._control.fileno(),), self.output, deadline):
                raise HostGoneError(f"no answer within {timeout_s:g} s")
            answer: dict[str, Any] = msgspec.json.decode(self._control.recv(MAX_PAYLOAD))
        except (OSError, ValueError) as error:  # it ended, or answers to an order before
            raise HostGoneError("it ended") from error
        return answer

    def close(self) -> None:
        """End the host and every process it forked."""
        self._control.close()
        try:
            self.process.wait(CLOSE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.output.close()
