"""The process that policies are forked from: heavy packages imported, no checkpoint loaded.

Started by ``HostConnection`` as ``python -m minitouch_bench.policies.forkserver FD PARENT SETUP``.
FD is a socket on which orders and answers, JSON each, take turns. For an episode it brings::

    a StartOrder and its descriptors
        -> {"pid": 123}  or  {"error": "...", "class": "PolicyLoadError"}, which ends it
    the seconds that the policy's process has to exit by itself
        -> {"status": -9, "killed": true, "grown_mb": 300}

``status`` is that of Popen.returncode, ``grown_mb`` the MiB by which the policy's process exceeded
what it was forked with, at most.

The descriptors are a socket for observations and answers, a pipe for what the policy prints, so
that nothing of one episode can be left in them for the next, and the checkpoint's file, if any.

The host reads orders only, and nothing that a policy says. The policy's process, forked for one
episode, loads the checkpoint, answers, and ends with the episode.
"""

import contextlib
import gc
import os
import random
import resource
import signal
import socket
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import numpy.random  # loaded lazily otherwise, so again in every child

from minitouch_bench import errors
from minitouch_bench.policies import policy, wire
from minitouch_bench.policies.sandbox import Sandbox, factory_paths, prepare
from minitouch_bench.processes import core_count, die_with
from minitouch_bench.protocol.spec import fit_action
from minitouch_bench.text import describe

CLOSE_ON_EXEC = getattr(socket, "MSG_CMSG_CLOEXEC", 0)
"""macOS does not have it; the children that the host forks do not start programs by themselves."""

POLL_S = 0.002
MAXRSS_IN_MIB = 2**20 if sys.platform == "darwin" else 2**10


def serve_episodes(control: socket.socket, setup: wire.HostSetup) -> None:
    """Obey the orders of one episode after the other, until the other side closes."""
    try:
        _import_format(setup.kind)
        sandbox = _make_sandbox(setup)
    except errors.MiniTouchError as error:
        control.recv(wire.MAX_PAYLOAD)
        problem = {"error": str(error), "class": type(error).__name__}
        control.sendall(msgspec.json.encode(problem))
        return
    while True:
        packet, descriptors, _, _ = socket.recv_fds(control, wire.MAX_PAYLOAD, 3, CLOSE_ON_EXEC)
        if not packet:
            return
        order = msgspec.json.decode(packet, type=wire.StartOrder)
        child = _fork_policy(order, sandbox, control, descriptors)
        for descriptor in descriptors:
            os.close(descriptor)
        with contextlib.suppress(ConnectionError):  # then there is no next order
            control.sendall(msgspec.json.encode({"pid": child}))
        grace = control.recv(wire.MAX_PAYLOAD) or b"0"
        end = _end_child(child, msgspec.json.decode(grace, type=float))
        with contextlib.suppress(ConnectionError):
            control.sendall(msgspec.json.encode(end))


def _fork_policy(
    order: wire.StartOrder, sandbox: Sandbox | None, control: socket.socket, descriptors: list[int]
) -> int:
    """Return the id of a process that plays an episode, and ends without returning."""
    host = os.getpid()
    child = os.fork()
    if child:
        return child
    try:
        os.setpgid(0, 0)
        die_with(host)
        control.close()  # orders are not the policy's to give
        channel, output, *files = descriptors
        _take_streams(output)
        if files:
            read = replace(order.source, content=_read_whole(files[0]))
            order = msgspec.structs.replace(order, source=read)
        _play(order, sandbox, channel)
        os._exit(0)
    finally:
        os._exit(1)


def _end_child(child: int, grace_s: float) -> dict[str, Any]:
    """Let the child exit, or kill it, and kill all it started: its number stays their group's."""
    deadline = time.monotonic() + grace_s
    ended, status, usage = os.wait4(child, os.WNOHANG)
    while not ended and time.monotonic() < deadline:
        time.sleep(POLL_S)
        ended, status, usage = os.wait4(child, os.WNOHANG)
    if not ended:
        os.kill(child, signal.SIGKILL)
        _, status, usage = os.wait4(child, 0)
    # It has no group right after the fork; macOS does not permit it for one that has ended.
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child, signal.SIGKILL)
    code = os.waitstatus_to_exitcode(status)
    grown_mb = usage.ru_maxrss // MAXRSS_IN_MIB - _shared_mb()
    return {"status": code, "killed": not ended, "grown_mb": grown_mb}


def _shared_mb() -> int:
    """Return what a child has of this process's memory when it begins; too much without /proc."""
    with contextlib.suppress(OSError):
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
        return int(status.partition("RssAnon:")[2].split()[0]) // 1024  # fork maps no file's pages
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // MAXRSS_IN_MIB


def _read_whole(descriptor: int) -> bytes:
    """Return a file's bytes, and close it: a policy could remember by its offset."""
    try:
        return os.pread(descriptor, os.fstat(descriptor).st_size, 0)
    finally:
        os.close(descriptor)


def _take_streams(output: int) -> None:
    """Give this process standard streams of its own: flags of the host's would be remembered."""
    null = os.open(os.devnull, os.O_RDONLY)
    for standard, taken in enumerate((null, output, output)):
        os.dup2(taken, standard)
    os.close(null)
    os.close(output)


def _make_sandbox(setup: wire.HostSetup) -> Sandbox | None:
    """Return a sandbox that was tried out, None where it is not asked for."""
    options = setup.options
    if options.level is not policy.Isolation.SANDBOX:
        return None
    own = factory_paths(setup.factory, options.private) if setup.factory else ((), ())
    # The formats compute on one thread, and only code that is trusted may start others.
    threads = core_count() if options.trust else 1
    limits = options.limits
    return prepare(limits.memory_mb * 2**20, limits.cpu_s * threads, *own, threads=options.trust)


def _import_format(kind: str) -> None:
    try:
        policy.find_loader(kind)
    except errors.MiniTouchError:
        raise
    except Exception as error:  # an installed package that does not import
        raise errors.PolicyLoadError(
            f"cannot read {kind} policies here: {describe(error)}"
        ) from error
    if "torch" in sys.modules:  # sums differ in their last bits between one and two threads
        sys.modules["torch"].set_num_threads(1)
    gc.collect()
    gc.freeze()  # children then share these pages for good


def _play(order: wire.StartOrder, sandbox: Sandbox | None, channel: int) -> None:
    """Confine this process, load the policy and answer observations; the first error ends it."""
    loaded = None
    try:
        with policy.own_faults(order.source.kind):
            seed_everything(order.seed)
            if sandbox is not None:
                sandbox.enter((channel,))
            # All before is ours, all after may be a stranger's.
            wire.write_frame(channel, wire.Frame.CONFINED)
            loaded = policy.load_policy(order.source)
            warning = policy.warning_of(loaded)
            wire.write_frame(channel, wire.Frame.LOADED, warning.encode(errors="replace"))
            seed_everything(order.seed)  # loading may have drawn numbers
            policy.begin_episode(loaded, order.seed, order.task)
            wire.write_frame(channel, wire.Frame.READY)
            with open(channel, "rb", closefd=False) as observations:
                while payload := observations.read(wire.OBSERVATION_BYTES):
                    action = loaded.act(wire.unpack_observation(payload))
                    fitted = fit_action(action, policy.action_size(order.task))
                    wire.write_frame(channel, wire.Frame.ACTION, fitted.tobytes())
    except errors.MiniTouchError as error:
        possible = (kind for kind, failure in wire.FAILURES.items() if isinstance(error, failure))
        text = " ".join(map(str, error.args))  # its str also says whose words they are
        wire.write_frame(channel, next(possible, wire.Frame.RAISED), text.encode(errors="replace"))
    policy.close_policy(loaded)


def seed_everything(seed: int) -> None:
    """Seed the generators of Python, numpy and, where they are loaded, torch and onnxruntime."""
    random.seed(seed)
    np.random.seed(seed % 2**32)  # noqa: NPY002 - a policy may well use the old generator
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(seed % 2**64)
    if "onnxruntime" in sys.modules:  # a session takes its seed when it is made
        sys.modules["onnxruntime"].set_seed(seed % 2**63)


def main() -> None:
    """Run the host on the socket named on its command line."""
    descriptor, parent = int(sys.argv[1]), int(sys.argv[2])
    setup = msgspec.json.decode(sys.argv[3], type=wire.HostSetup)
    die_with(parent)
    serve_episodes(socket.socket(fileno=descriptor), setup)


if __name__ == "__main__":
    main()
