"""The process that policies are forked from: heavy packages imported, no checkpoint loaded.

Started by ``connection`` as ``python -m minitouch_bench.policies.forkserver FD PARENT``. FD is a
socket on which every packet is one JSON object::

    a StartOrder and two descriptors
        -> {"pid": 123}  or  {"error": "...", "class": "PolicyLoadError"}
    a StopOrder
        -> {"status": -9, "killed": true}   status as in Popen.returncode, 0 without a child

The descriptors are the child's own: a socket for requests and answers, and a pipe for what it
prints, so that nothing of one episode can be left in them for the next.

The child is an episode of its own: it loads the checkpoint, answers, and ends with the episode.
"""

import contextlib
import gc
import os
import random
import signal
import socket
import sys
import time
from dataclasses import replace
from functools import cache
from typing import Any, NoReturn

import msgspec
import numpy as np
import numpy.random  # loaded lazily otherwise, so again in every child

from minitouch_bench import errors
from minitouch_bench.policies import wire
from minitouch_bench.policies.formats import FORMATS
from minitouch_bench.policies.policy import (
    Isolation,
    action_size,
    check_permitted,
    close_policy,
    find_loader,
    load_policy,
    warning_of,
)
from minitouch_bench.policies.sandbox import NOTHING, Sandbox, factory_paths, prepare
from minitouch_bench.policies.sources import read_again
from minitouch_bench.processes import core_count, die_with
from minitouch_bench.protocol.minitouch import PolicyLimits
from minitouch_bench.protocol.spec import fit_action

CLOSE_ON_EXEC = getattr(socket, "MSG_CMSG_CLOEXEC", 0)
"""macOS does not have it; the children that the host forks do not start programs by themselves."""

POLL_S = 0.002


class Host:
    """Fork one child an episode, and end the one before."""

    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._child = 0

    def serve(self) -> None:
        """Obey until the other side closes."""
        while True:
            packet, descriptors, _, _ = socket.recv_fds(
                self._control, wire.MAX_PAYLOAD, 2, CLOSE_ON_EXEC
            )
            if not packet:
                break
            order = msgspec.json.decode(packet, type=wire.Order)
            if isinstance(order, wire.StartOrder):
                answer = self._start(order, descriptors)
            else:
                status, killed = self._end_child(order.grace_s)
                answer = {"status": status, "killed": killed}
            self._control.sendall(msgspec.json.encode(answer))
        self._end_child(0.0)

    def _start(self, order: wire.StartOrder, descriptors: list[int]) -> dict[str, Any]:
        self._end_child(0.0)
        try:
            return {"pid": self._fork(*_prepare(order), *descriptors)}
        except errors.MiniTouchError as error:
            return {"error": str(error), "class": type(error).__name__}
        finally:
            for descriptor in descriptors:
                os.close(descriptor)

    def _fork(
        self, order: wire.StartOrder, sandbox: Sandbox | None, channel: int, output: int
    ) -> int:
        host = os.getpid()
        child = os.fork()
        if child == 0:
            try:
                os.setpgid(0, 0)
                die_with(host)
                self._control.close()  # orders to the host are not the policy's to give
                _take_streams(output)
                serve_episode(order, sandbox, channel)
            finally:
                os._exit(1)
        self._child = child
        return child

    def _end_child(self, grace_s: float) -> tuple[int, bool]:
        """Let the child exit, then kill it with all it started; reap it last, to keep its id."""
        if not self._child:
            return 0, False
        deadline = time.monotonic() + grace_s
        while (end := _find_end(self._child)) is None and time.monotonic() < deadline:
            time.sleep(POLL_S)
        for kill in (os.killpg, os.kill):  # right after the fork it has no group yet
            # macOS says of a group whose processes have all exited that it is not permitted.
            with contextlib.suppress(ProcessLookupError, PermissionError):
                kill(self._child, signal.SIGKILL)
        _, status = end or os.waitpid(self._child, 0)
        self._child = 0
        return os.waitstatus_to_exitcode(status), end is None


def _take_streams(output: int) -> None:
    """Give this process standard streams of its own: flags of the host's would be remembered."""
    null = os.open(os.devnull, os.O_RDONLY)
    for standard, taken in enumerate((null, output, output)):
        os.dup2(taken, standard)
    os.close(null)
    os.close(output)


def _find_end(child: int) -> tuple[int, int] | tuple[()] | None:
    """Return None while a child runs, then what ``waitpid`` says, or () if it is not yet reaped."""
    if hasattr(os, "waitid"):
        options = os.WEXITED | os.WNOHANG | os.WNOWAIT
        return None if os.waitid(os.P_PID, child, options) is None else ()
    end = os.waitpid(child, os.WNOHANG)  # macOS before Python 3.13 cannot look without reaping
    return end if end[0] else None


def _prepare(order: wire.StartOrder) -> tuple[wire.StartOrder, Sandbox | None]:
    """Import what the kind needs, read its file into the order and make its sandbox, each once."""
    source, options = order.source, order.options
    check_permitted(source, options.level, trust=options.trust)
    _import_format(source.kind)
    if FORMATS[source.kind].suffixes:
        read = replace(source, content=_read(source.target, source.digest))
        order = msgspec.structs.replace(order, source=read)
    if options.level is not Isolation.SANDBOX:
        return order, None
    factory = (source.target, options.private) if source.kind == "factory" else ()
    return order, _make_sandbox(options.limits, factory, options.trust)


_read = cache(read_again)


@cache
def _make_sandbox(limits: PolicyLimits, factory: tuple[str, ...], trust: bool) -> Sandbox:
    """Return a sandbox that was tried out; ``factory``: what ``factory_paths`` is asked for."""
    paths = factory_paths(*factory) if factory else NOTHING
    # The formats compute on one thread, and only code that is trusted may start others.
    threads = core_count() if trust else 1
    return prepare(limits.memory_mb * 2**20, limits.cpu_s * threads, paths, threads=trust)


@cache
def _import_format(kind: str) -> None:
    try:
        find_loader(kind)
    except errors.MiniTouchError:
        raise
    except Exception as error:  # an installed package that does not import
        raise errors.PolicyLoadError(
            f"cannot read {kind} policies here: {errors.describe(error)}"
        ) from error
    if "torch" in sys.modules:  # sums differ in their last bits between one and two threads
        sys.modules["torch"].set_num_threads(1)
    gc.collect()
    gc.freeze()  # children then share these pages for good


def serve_episode(order: wire.StartOrder, sandbox: Sandbox | None, channel: int) -> NoReturn:
    """Confine this process, answer requests until they end, then exit."""
    code = 1
    try:
        seed_everything(order.seed)
        if _confine(sandbox, channel):
            _serve(order, channel)
        code = 0
    except SystemExit as stop:  # sys.exit() in a policy ends its process, as it would anywhere
        code = stop.code & 0xFF if isinstance(stop.code, int) else int(stop.code is not None)
        if isinstance(stop.code, str):
            print(stop.code, file=sys.stderr, flush=True)
    except BrokenPipeError:  # the evaluation gave this episode up
        code = 0
    finally:
        os._exit(code)


def seed_everything(seed: int) -> None:
    """Seed the generators of Python, numpy and, where they are loaded, torch and onnxruntime."""
    random.seed(seed)
    np.random.seed(seed % 2**32)  # noqa: NPY002 - a policy may well use the old generator
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(seed % 2**64)
    if "onnxruntime" in sys.modules:  # a session takes its seed when it is made
        sys.modules["onnxruntime"].set_seed(seed % 2**63)


def _confine(sandbox: Sandbox | None, channel: int) -> bool:
    """Enter the sandbox, if there is one: all before is ours, all after may be a stranger's."""
    try:
        if sandbox is not None:
            sandbox.enter((channel,))
    except OSError as error:
        wire.write_frame(channel, wire.Frame.UNCONFINED, errors.describe(error).encode())
        return False
    wire.write_frame(channel, wire.Frame.CONFINED)
    return True


def _serve(order: wire.StartOrder, channel: int) -> None:
    policy, size = None, action_size(order.task)
    while True:
        try:
            request, payload = wire.read_frame(channel)
        except EOFError:
            break
        try:
            if request is wire.Frame.LOAD:
                policy = load_policy(order.source)
                warning = errors.plain_line(warning_of(policy), 2 * errors.MAX_TEXT)
                kind, answer = wire.Frame.LOADED, warning.encode(errors="replace")
            elif policy is None:
                raise wire.WireError(f"a request of kind {request} before LOAD")
            elif request is wire.Frame.RESET:
                seed_everything(order.seed)  # loading may have drawn numbers
                policy.reset(order.seed, order.task)
                kind, answer = wire.Frame.READY, b""
            else:
                action = fit_action(policy.act(wire.unpack_observation(payload)), size)
                kind, answer = wire.Frame.ACTION, wire.pack_action(action)
        except SystemExit:
            raise
        except BaseException as error:
            kind = wire.Frame.RAISED
            if request is wire.Frame.LOAD and isinstance(error, errors.MiniTouchError):
                kind = wire.Frame.REFUSED
            elif isinstance(error, errors.InvalidActionError):
                kind = wire.Frame.INVALID
            text = _in_words(error) if kind is wire.Frame.RAISED else str(error)
            answer = text.encode(errors="replace")
        wire.write_frame(channel, kind, answer[: wire.MAX_PAYLOAD])
    close_policy(policy)


def _in_words(error: BaseException) -> str:
    """Say what a policy raised; of words that are told as the policy's, the parent says so."""
    if isinstance(error, errors.PolicyRaisedError):
        return " ".join(map(str, error.args))
    return errors.describe(error)


def main() -> None:
    """Run the host on the socket named on its command line."""
    descriptor, parent = int(sys.argv[1]), int(sys.argv[2])
    die_with(parent)
    with socket.socket(fileno=descriptor) as control:
        Host(control).serve()


if __name__ == "__main__":
    main()
