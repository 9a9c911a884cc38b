"""The process that policies are forked from: heavy packages imported, no checkpoint loaded.

Started by ``connection`` as ``python -m minitouch_bench.policies.host FD PARENT``. FD is a
socket on which every packet is one JSON object::

    {"do": "start", kind, target, digest, deterministic, trust, seed, task, isolation,
     private, memory_bytes, cpu_s} + three descriptors
        -> {"pid": 123}  or  {"error": "...", "class": "PolicyLoadError"}
    {"do": "stop", "grace_s": 0.2}
        -> {"status": -9, "killed": true}   status as in Popen.returncode, 0 without a child

The descriptors are the child's own pipe ends, for requests, for answers and for what it prints,
so that nothing of one episode can be left in the pipes of the next.

The child is an episode of its own: it loads the checkpoint, answers, and ends with the episode.
"""

import contextlib
import gc
import json
import os
import random
import signal
import socket
import sys
import time
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
import numpy.random  # loaded lazily otherwise, so again in every child

from minitouch_bench.errors import MiniTouchError, PolicyLoadError, PolicyRaisedError
from minitouch_bench.policies.formats import FORMATS, check_permitted, find_loader, load_policy
from minitouch_bench.policies.isolation.kernel import ProcessLimits
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.policies.isolation.readable import NOTHING, factory_paths
from minitouch_bench.policies.isolation.sandbox import Sandbox, prepare
from minitouch_bench.policies.policy import Checkpoint, close_policy
from minitouch_bench.policies.sources import read_again
from minitouch_bench.policies.wire import (
    MAX_PAYLOAD,
    Frame,
    WireError,
    describe,
    pack_action,
    read_frame,
    unpack_observation,
    write_frame,
)
from minitouch_bench.processes import die_with

POLL_S = 0.002


@dataclass(frozen=True)
class Episode:
    """What a child is forked for: which policy, which task, which seed, and what holds it."""

    kind: str
    checkpoint: Checkpoint
    task: str
    seed: int
    sandbox: Sandbox | None = None


class Host:
    """Fork one child an episode, and end the one before."""

    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._child = 0
        self._contents: dict[str, bytes] = {}
        self._imported: set[str] = set()
        self._sandboxes: dict[str, Sandbox] = {}

    def serve(self) -> None:
        """Obey until the other side closes."""
        while True:
            packet, descriptors, _, _ = socket.recv_fds(
                self._control, MAX_PAYLOAD, 3, socket.MSG_CMSG_CLOEXEC
            )
            if not packet:
                break
            order = json.loads(packet)
            if order["do"] == "start":
                answer = self._start(order, descriptors)
            else:
                status, killed = self._end_child(order["grace_s"])
                answer = {"status": status, "killed": killed}
            self._control.sendall(json.dumps(answer).encode())
        self._end_child(0.0)

    def _start(self, order: dict[str, Any], descriptors: list[int]) -> dict[str, Any]:
        self._end_child(0.0)
        try:
            episode = self._prepare(order)
            return {"pid": self._fork(episode, *descriptors)}
        except MiniTouchError as error:
            return {"error": str(error), "class": type(error).__name__}
        finally:
            for descriptor in descriptors:
                os.close(descriptor)

    def _prepare(self, order: dict[str, Any]) -> Episode:
        """Import what the kind needs, read its file and prepare its sandbox, each once."""
        kind, target = order["kind"], order["target"]
        check_permitted(kind, target, Isolation(order["isolation"]), trust=order["trust"])
        if kind not in self._imported:
            _import_format(kind)
            self._imported.add(kind)
        if FORMATS[kind].suffixes and target not in self._contents:
            self._contents[target] = read_again(target, order["digest"])
        checkpoint = Checkpoint(
            target, self._contents.get(target, b""), order["deterministic"], order["trust"]
        )
        return Episode(kind, checkpoint, order["task"], order["seed"], self._sandbox(order))

    def _sandbox(self, order: dict[str, Any]) -> Sandbox | None:
        """Return the sandbox for an order's kind of policy, which is tried out once."""
        if order["isolation"] != Isolation.SANDBOX:
            return None
        kind = order["kind"]
        if kind not in self._sandboxes:
            own = NOTHING
            if kind == "factory":
                own = factory_paths(order["target"], order["private"])
            allowed = ProcessLimits(order["memory_bytes"], order["cpu_s"])
            # The formats compute on one thread; what else a file starts is not counted by time.
            self._sandboxes[kind] = prepare(allowed, own, threads=order["trust"])
        return self._sandboxes[kind]

    def _fork(self, episode: Episode, requests: int, answers: int, output: int) -> int:
        host = os.getpid()
        child = os.fork()
        if child == 0:
            try:
                os.setpgid(0, 0)
                die_with(host)
                self._control.close()  # orders to the host are not the policy's to give
                _take_streams(output)
                run_episode(episode, requests, answers)
            finally:
                os._exit(1)
        self._child = child
        return child

    def _end_child(self, grace_s: float) -> tuple[int, bool]:
        """Give the child so long to exit by itself, then kill it with all it started.

        It is reaped last: until then its id, and its group's, can name nobody else.
        """
        if not self._child:
            return 0, False
        deadline = time.monotonic() + grace_s
        while not (exited := _has_exited(self._child)) and time.monotonic() < deadline:
            time.sleep(POLL_S)
        for kill in (os.killpg, os.kill):  # right after the fork it has no group yet
            with contextlib.suppress(ProcessLookupError):
                kill(self._child, signal.SIGKILL)
        _, status = os.waitpid(self._child, 0)
        self._child = 0
        return os.waitstatus_to_exitcode(status), not exited


def _take_streams(output: int) -> None:
    """Give this process standard streams of its own: flags of the host's would be remembered."""
    null = os.open(os.devnull, os.O_RDONLY)
    for standard, own in enumerate((null, output, output)):
        os.dup2(own, standard)
    os.close(null)
    os.close(output)


def _has_exited(child: int) -> bool:
    return os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def _import_format(kind: str) -> None:
    try:
        find_loader(kind)
    except MiniTouchError:
        raise
    except Exception as error:  # an installed package that does not import
        raise PolicyLoadError(f"cannot read {kind} policies here: {describe(error)}") from error
    if "torch" in sys.modules:  # sums differ in their last bits between one and two threads
        sys.modules["torch"].set_num_threads(1)
    gc.collect()
    gc.freeze()  # children then share these pages for good


def run_episode(episode: Episode, requests: int, answers: int) -> NoReturn:
    """Confine this process, answer requests until they close, then exit."""
    code = 1
    try:
        seed_everything(episode.seed)
        if _confine(episode, requests, answers):
            _serve(episode, requests, answers)
        code = 0
    except SystemExit as stop:  # sys.exit() in a policy ends its process, as it would anywhere
        code = _exit_code(stop)
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


def _confine(episode: Episode, requests: int, answers: int) -> bool:
    """Enter the sandbox, if there is one: all before is ours, all after may be a stranger's."""
    try:
        if episode.sandbox is not None:
            episode.sandbox.enter((requests, answers))
    except OSError as error:
        write_frame(answers, Frame.UNCONFINED, describe(error).encode())
        return False
    write_frame(answers, Frame.CONFINED)
    return True


def _serve(episode: Episode, requests: int, answers: int) -> None:
    """Answer each request, one frame to one, until they end."""
    policy = None
    while True:
        try:
            request, payload = read_frame(requests)
        except EOFError:
            break
        try:
            if request is Frame.LOAD:
                policy = load_policy(episode.kind, episode.checkpoint)
                kind, answer = Frame.LOADED, b""
            elif policy is None:
                raise WireError(f"a request of kind {request} before LOAD")
            elif request is Frame.RESET:
                seed_everything(episode.seed)  # loading may have drawn numbers
                policy.reset(episode.seed, episode.task)
                kind, answer = Frame.READY, b""
            else:
                action = policy.act(unpack_observation(payload))
                kind, answer = Frame.ACTION, pack_action(action)
        except SystemExit:
            raise
        except BaseException as error:
            refused = request is Frame.LOAD and isinstance(error, MiniTouchError)
            # A loader's own words need no type before them.
            plain = refused or isinstance(error, PolicyRaisedError)
            kind = Frame.REFUSED if refused else Frame.RAISED
            answer = (str(error) if plain else describe(error)).encode(errors="replace")
        write_frame(answers, kind, answer[:MAX_PAYLOAD])
    close_policy(policy)


def _exit_code(stop: SystemExit) -> int:
    """Return the code that Python itself would exit with, and print a text as it would."""
    if stop.code is None:
        return 0
    if isinstance(stop.code, int):
        return stop.code & 0xFF
    print(stop.code, file=sys.stderr, flush=True)
    return 1


def main() -> None:
    """Run the host on the socket named on its command line."""
    descriptor, parent = int(sys.argv[1]), int(sys.argv[2])
    die_with(parent)
    with socket.socket(fileno=descriptor) as control:
        Host(control).serve()


if __name__ == "__main__":
    main()
