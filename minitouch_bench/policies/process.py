"""A policy in a process of its own: the trusted side, which never imports torch."""

import contextlib
import os
import signal
import time
from collections.abc import Mapping
from types import TracebackType
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.errors import (
    InfrastructureError,
    IsolationError,
    MiniTouchError,
    MissingExtraError,
    PolicyExitError,
    PolicyFaultError,
    PolicyKilledError,
    PolicyLoadError,
    PolicyRaisedError,
    PolicyTimeoutError,
)
from minitouch_bench.policies.episode_pipes import EpisodePipes
from minitouch_bench.policies.host_connection import HostConnection, HostGoneError
from minitouch_bench.policies.isolation.options import SANDBOXED, IsolationOptions
from minitouch_bench.policies.policy import (
    Observation,
    action_size,
)
from minitouch_bench.policies.sources import PolicySource
from minitouch_bench.policies.wire import (
    Frame,
    WireError,
    pack_frame,
    pack_observation,
    plain_line,
    unpack_action,
)
from minitouch_bench.tasks.action import fit_action

EXIT_GRACE_S = 0.2
"""Time in which a process that closed its pipe must have exited, to be asked for its status."""

END_GRACE_S = {"remote": 1.0}
"""Time by kind to end an episode in good order; what only this machine holds is just killed."""

STOP_TIMEOUT_S = 10.0

REFUSALS: Mapping[str, type[MiniTouchError]] = {
    error.__name__: error for error in (IsolationError, MissingExtraError, PolicyLoadError)
}
"""What a host may answer to the order to start an episode."""


class PolicyProcess:
    """Run a policy in a process that is forked afresh for every episode.

    A host process imports what the format needs once. For each episode it forks a child that
    loads the checkpoint, so nothing can be remembered from one episode to the next.
    """

    def __init__(
        self,
        source: PolicySource,
        options: IsolationOptions = SANDBOXED,
        *,
        deterministic: bool = True,
    ) -> None:
        if source.kind == "scripted":
            raise ValueError("the scripted policy reads the simulator: it runs beside it")
        self._source = source
        self._options = options
        self._limits = options.limits
        self._deterministic = deterministic
        self._host: HostConnection | None = None
        self._pipes: EpisodePipes | None = None
        self._size = 0
        self._end_grace_s = 0.0

    def __enter__(self) -> "PolicyProcess":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(error, KeyboardInterrupt):
            self._drop_host()  # what it was asked last is still unanswered
        else:
            self.close()

    def reset(self, seed: int, task: str) -> None:
        """Begin an episode in a fresh child.

        Raises:
            PolicyLoadError: the checkpoint cannot be loaded.
            IsolationError: this machine has no sandbox to hold it in.
            MissingExtraError: an optional package is not installed.
            PolicyFaultError: the policy's own ``reset`` failed; see its subclasses.
            InfrastructureError: no host process can be started.

        """
        part = self._source.for_task(task)
        order = {
            "do": "start",
            "kind": part.kind,
            "target": part.target,
            "digest": part.digest,
            "deterministic": self._deterministic,
            "trust": self._options.trust,
            "task": task,
            "seed": seed,
            "isolation": self._options.level,
            "memory_bytes": self._limits.memory_mb * 2**20,
            "cpu_s": self._limits.cpu_s,
        }
        limit_s = self._limits.load_timeout_s
        deadline = time.monotonic() + limit_s
        self._end_episode()
        self._size = action_size(task)
        self._end_grace_s = END_GRACE_S.get(part.kind, 0.0)
        self._pipes = self._start(order)
        self._await_loaded(deadline, part.target)
        kind, payload = self._ask(deadline, f"reset did not return within {limit_s:g} s")
        if kind is not Frame.READY:
            self._fail(kind, payload)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the policy's action, float32 of the task's size, finite, not clipped.

        Raises:
            InvalidActionError: wrong length or type, NaN or infinity.
            PolicyTimeoutError: no answer in time; the child is killed.
            PolicyExitError: the child ended; the text has its code and last line.
            PolicyRaisedError: the policy's code raised; the text has type and message.
            InfrastructureError: the host process ended.

        """
        if self._pipes is None:
            raise RuntimeError("no episode has begun")
        deadline = time.monotonic() + self._limits.act_timeout_s
        self._pipes.send(pack_frame(Frame.ACT, pack_observation(observation)))
        kind, payload = self._ask(deadline, f"no action within {self._limits.act_timeout_s:g} s")
        if kind is not Frame.ACTION:
            self._fail(kind, payload)
        try:
            raw = unpack_action(payload)
        except WireError as error:
            self._break_off(error)
        return fit_action(raw, self._size)

    def close(self) -> None:
        """End the child and the host."""
        self._end_episode()
        self._drop_host()

    def _drop_host(self) -> None:
        if self._pipes is not None:
            self._pipes.close()
            self._pipes = None
        if self._host is not None:
            self._host.close()
            self._host = None

    def _start(self, order: dict[str, Any]) -> EpisodePipes:
        """Have a child forked; a host that has ended is replaced, once."""
        for _ in range(2):
            if self._host is None:
                self._host = HostConnection(self._options.level)
            requests, ours = os.pipe()
            answers, theirs = os.pipe()
            pipes = EpisodePipes(self._host, ours, answers)
            try:
                answer = self._host.order(order, self._limits.load_timeout_s, (requests, theirs))
                break
            except HostGoneError as error:
                problem = f"{error}: {self._host.last_line()}"
                pipes.close()
                self._drop_host()
            finally:
                os.close(requests)
                os.close(theirs)
        else:
            raise InfrastructureError(f"the policy's host process cannot work ({problem})")
        if "error" in answer:
            pipes.close()
            raise REFUSALS.get(answer["class"], PolicyLoadError)(answer["error"])
        pipes.watch(answer["pid"])
        return pipes

    def _await_loaded(self, deadline: float, target: str) -> None:
        try:
            late = f"it was not loaded within {self._limits.load_timeout_s:g} s"
            kind, payload = self._ask(deadline, late)
        except PolicyKilledError:
            raise
        except PolicyFaultError as fault:  # before its first answer a policy is not loaded
            raise PolicyLoadError(f"{target} cannot be loaded: {fault}") from fault
        if kind is Frame.LOADED:
            return
        self._stop(0.0)
        text = plain_line(payload.decode(errors="replace"))
        if kind is Frame.UNCONFINED:
            raise InfrastructureError(f"the policy's process could not enter its sandbox: {text}")
        raise (MissingExtraError if kind is Frame.MISSING_EXTRA else PolicyLoadError)(text)

    def _ask(self, deadline: float, late: str) -> tuple[Frame, bytes]:
        """Return the child's next frame, or end the child and raise what went wrong."""
        assert self._pipes is not None
        try:
            return self._pipes.receive(deadline)
        except TimeoutError:
            self._stop(0.0)
            raise PolicyTimeoutError(late) from None
        except EOFError:
            raise self._exit_error() from None
        except WireError as error:
            self._break_off(error)

    def _fail(self, kind: Frame, payload: bytes) -> NoReturn:
        self._stop(0.0)
        if kind is Frame.RAISED:
            raise PolicyRaisedError(plain_line(payload.decode(errors="replace")))
        raise PolicyExitError("the policy's process broke the protocol")

    def _break_off(self, error: WireError) -> NoReturn:
        self._stop(0.0)
        raise PolicyExitError(f"the policy's process broke the protocol: {error}") from None

    def _exit_error(self) -> PolicyExitError:
        """Say how a child ended that closed its pipe, and what it printed last."""
        status, killed = self._stop(EXIT_GRACE_S)
        if killed:
            text = "the policy's process closed its connection"
        elif status < 0:
            text = f"the policy's process was killed by {_signal_name(-status)}"
        else:
            text = f"the policy's process exited with code {status}"
        line = self._host.last_line() if self._host is not None else ""
        from_outside = not killed and status == -signal.SIGKILL
        kind = PolicyKilledError if from_outside else PolicyExitError
        return kind(f"{text}: {line}" if line else text)

    def _stop(self, grace_s: float) -> tuple[int, bool]:
        """End the child; return its status and whether it had to be killed.

        Raises:
            InfrastructureError: the host itself has ended.

        """
        assert self._host is not None
        if self._pipes is not None:
            self._pipes.close()
            self._pipes = None
        try:
            answer = self._host.order({"do": "stop", "grace_s": grace_s}, STOP_TIMEOUT_S)
        except HostGoneError as error:
            self._drop_host()
            raise InfrastructureError(f"the policy's host process ended ({error})") from error
        return answer["status"] or 0, answer["killed"]

    def _end_episode(self) -> None:
        """End the last episode's child; if the host is gone, so is the child."""
        if self._host is None:
            return
        with contextlib.suppress(InfrastructureError):
            self._stop(self._end_grace_s if self._pipes is not None else 0.0)
            self._host.forget_output()


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
