"""The process that policies are forked from: heavy packages imported, no checkpoint loaded.

Started by ``connection`` as ``python -m minitouch_bench.policies.forkserver FD PARENT SETUP``. FD
is a socket on which every packet is one JSON object. For an episode it brings::

    a StartOrder and its descriptors
        -> {"pid": 123}  or  {"error": "...", "class": "PolicyLoadError"}, which ends it
    the seconds that the policy's process has to exit by itself
        -> {"status": -9, "killed": true, "grown_mb": 300}

``status`` is that of Popen.returncode, ``grown_mb`` the MiB by which the policy's process exceeded
what it was forked with, at most.

The descriptors are a socket for requests and answers, a pipe for what the policy prints, so that
nothing of one episode can be left in them for the next, and the checkpoint's file, if it has one.

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
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import msgspec
import numpy as np
import numpy.random  # loaded lazily otherwise, so again in every child

from minitouch_bench import errors
from minitouch_bench.policies import policy, wire
from minitouch_bench.policies.sandbox import NOTHING, Sandbox, factory_paths, prepare
from minitouch_bench.processes import core_count, die_with
from minitouch_bench.protocol.spec import fit_action
from minitouch_bench.text import MAX_TEXT, describe, plain_line

CLOSE_ON_EXEC = getattr(socket, "MSG_CMSG_CLOEXEC", 0)
"""macOS does not have it; the children that the host forks do not start programs by themselves."""

POLL_S = 0.002
MAXRSS_IN_MIB = 2**20 if sys.platform == "darwin" else 2**10


def serve_episodes(control: socket.socket, setup: wire.HostSetup) -> None:
    """Obey the orders of one episode after the other, until the other side closes."""
    sandbox, problem = None, None
    try:
        _import_format(setup.kind)
        sandbox = _make_sandbox(setup)
    except errors.MiniTouchError as error:
        problem = {"error": str(error), "class": type(error).__name__}

    def answer(document: Mapping[str, Any]) -> None:
        with contextlib.suppress(ConnectionError):  # then there is no next order
            control.sendall(msgspec.json.encode(document))

    while True:
        packet, descriptors, _, _ = socket.recv_fds(control, wire.MAX_PAYLOAD, 3, CLOSE_ON_EXEC)
        if not packet:
            return
        if problem is None:
            order = msgspec.json.decode(packet, type=wire.StartOrder)
            child = _fork_policy(order, sandbox, control, descriptors)
        for descriptor in descriptors:
            os.close(descriptor)
        if problem is None:
            answer({"pid": child})
            grace = control.recv(wire.MAX_PAYLOAD) or b"0"
            answer(_end_child(child, msgspec.json.decode(grace, type=float)))
        else:
            answer(problem)


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
        serve_episode(order, sandbox, channel)
    finally:
        os._exit(1)


def _end_child(child: int, grace_s: float) -> dict[str, Any]:
    """Let the child exit, then kill it with all it started; reap it last, to keep its id."""
    deadline = time.monotonic() + grace_s
    while (end := _find_end(child)) is None and time.monotonic() < deadline:
        time.sleep(POLL_S)
    for kill in (os.killpg, os.kill):  # right after the fork it has no group yet
        # macOS says of a group whose processes have all exited that it is not permitted.
        with contextlib.suppress(ProcessLookupError, PermissionError):
            kill(child, signal.SIGKILL)
    grown_mb = 0
    if end:
        status = end[1]
    else:
        _, status, usage = os.wait4(child, 0)
        grown_mb = usage.ru_maxrss // MAXRSS_IN_MIB - _shared_mb()
    code = os.waitstatus_to_exitcode(status)
    return {"status": code, "killed": end is None, "grown_mb": grown_mb}


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


def _find_end(child: int) -> tuple[int, int] | tuple[()] | None:
    """Return None while a child runs, then what ``waitpid`` says, or () if it is not yet reaped."""
    if hasattr(os, "waitid"):
        options = os.WEXITED | os.WNOHANG | os.WNOWAIT
        return None if os.waitid(os.P_PID, child, options) is None else ()
    end = os.waitpid(child, os.WNOHANG)  # macOS before Python 3.13 cannot look without reaping
    return end if end[0] else None


def _make_sandbox(setup: wire.HostSetup) -> Sandbox | None:
    """Return a sandbox that was tried out, None where it is not asked for."""
    options = setup.options
    if options.level is not policy.Isolation.SANDBOX:
        return None
    paths = factory_paths(setup.factory, options.private) if setup.factory else NOTHING
    # The formats compute on one thread, and only code that is trusted may start others.
    threads = core_count() if options.trust else 1
    limits = options.limits
    return prepare(limits.memory_mb * 2**20, limits.cpu_s * threads, paths, threads=options.trust)


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


def serve_episode(order: wire.StartOrder, sandbox: Sandbox | None, channel: int) -> NoReturn:
    """Confine this process, answer requests until they end, then exit."""
    code = 1
    try:
        seed_everything(order.seed)
        try:  # all before is ours, all after may be a stranger's
            if sandbox is not None:
                sandbox.enter((channel,))
        except OSError as error:
            wire.write_frame(channel, wire.Frame.UNCONFINED, describe(error).encode())
        else:
            wire.write_frame(channel, wire.Frame.CONFINED)
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


def _serve(order: wire.StartOrder, channel: int) -> None:
    loaded, size = None, policy.action_size(order.task)
    while True:
        try:
            request, payload = wire.read_frame(channel)
        except EOFError:
            break
        try:
            if request is wire.Frame.LOAD:
                loaded = policy.load_policy(order.source)
                warning = plain_line(policy.warning_of(loaded), 2 * MAX_TEXT)
                kind, answer = wire.Frame.LOADED, warning.encode(errors="replace")
            elif loaded is None:
                raise wire.WireError(f"a request of kind {request} before LOAD")
            elif request is wire.Frame.RESET:
                seed_everything(order.seed)  # loading may have drawn numbers
                loaded.reset(order.seed, order.task)
                kind, answer = wire.Frame.READY, b""
            else:
                action = fit_action(loaded.act(wire.unpack_observation(payload)), size)
                kind, answer = wire.Frame.ACTION, wire.pack_action(action)
        except SystemExit:
            raise
        except BaseException as error:
            kind = wire.Frame.RAISED
            refusals = errors.PolicyLoadError, errors.MissingExtraError
            if request is not wire.Frame.ACT and isinstance(error, refusals):
                kind = wire.Frame.REFUSED
            elif isinstance(error, errors.InvalidActionError):
                kind = wire.Frame.INVALID
            elif policy.is_unreachable(order.source.kind, error):
                kind = wire.Frame.UNREACHABLE
            text = _in_words(error) if kind is wire.Frame.RAISED else str(error)
            answer = text.encode(errors="replace")
        wire.write_frame(channel, kind, answer[: wire.MAX_PAYLOAD])
    policy.close_policy(loaded)


def _in_words(error: BaseException) -> str:
    """Say what a policy raised; of words that are told as the policy's, the parent says so."""
    if isinstance(error, errors.PolicyRaisedError):
        return " ".join(map(str, error.args))
    return describe(error)


def main() -> None:
    """Run the host on the socket named on its command line."""
    descriptor, parent = int(sys.argv[1]), int(sys.argv[2])
    setup = msgspec.json.decode(sys.argv[3], type=wire.HostSetup)
    die_with(parent)
    serve_episodes(socket.socket(fileno=descriptor), setup)


if __name__ == "__main__":
    main()
