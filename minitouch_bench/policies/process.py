"""A policy in a process of its own: the trusted side, which never imports torch."""

import contextlib
import signal
import time
from collections.abc import Mapping
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from minitouch_bench import errors
from minitouch_bench.policies import wire
from minitouch_bench.policies.connection import EpisodeChannel, HostConnection, HostGoneError
from minitouch_bench.policies.kernel import ProcessLimits
from minitouch_bench.policies.policy import SANDBOXED, IsolationOptions, Observation, action_size
from minitouch_bench.policies.sources import PolicySource
from minitouch_bench.processes import core_count
from minitouch_bench.tasks.action import fit_action

EXIT_GRACE_S = 0.2
"""Time in which a process that closed its pipe must have exited, to be asked for its status."""

END_GRACE_S = {"remote": 1.0}
"""Time by kind to end an episode in good order; what only this machine holds is just killed."""

STOP_TIMEOUT_S = 10.0

REFUSALS: Mapping[str, type[errors.MiniTouchError]] = {
    error.__name__: error
    for error in (
        errors.CheckpointChangedError,
        errors.IsolationError,
        errors.MissingExtraError,
        errors.PolicyLoadError,
    )
}
"""What a host may answer to the order to start an episode."""


class _Ending(NamedTuple):
    """How a child ended: its exit status, whether it had to be killed, what it printed last."""

    status: int
    killed: bool
    last_line: str


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
        self._channel: EpisodeChannel | None = None
        self.warning = ""
        self._target = ""
        self._size = 0
        self._end_grace_s = 0.0
        self._left_s = 0.0

    def __enter__(self) -> "PolicyProcess":
        return self

    def __exit__(self, *_: object) -> None:
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
        options, limits = self._options, self._limits
        threads = core_count() if options.trust else 1  # the sandbox forbids others to start any
        allowed = ProcessLimits(limits.memory_mb * 2**20, limits.cpu_s * threads)
        order = wire.StartOrder(
            kind=part.kind, target=part.target, digest=part.digest, task=task, seed=seed,
            deterministic=self._deterministic, isolation=options.level, trust=options.trust,
            private=options.private, limits=allowed,
        )  # fmt: skip
        self._end_episode()
        self._target = part.target
        self._size = action_size(task)
        self._left_s = self._limits.episode_timeout_s
        self._end_grace_s = END_GRACE_S.get(part.kind, 0.0)
        self._start(order)
        deadline = time.monotonic() + limits.load_timeout_s
        self._await_confined(deadline)
        self._load(deadline)
        late = f"reset did not return within {limits.load_timeout_s:g} s"
        self._ask(wire.Frame.RESET, b"", wire.Frame.READY, deadline, late)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the policy's action, float32 of the task's size, finite, not clipped.

        Raises:
            InvalidActionError: wrong length or type, NaN or infinity.
            PolicyTimeoutError: no answer in time; the child is killed.
            PolicyExitError: the child ended; the text has its code and last line.
            PolicyKilledError: the child was killed from outside.
            PolicyRaisedError: the policy's code raised; the text has type and message.
            InfrastructureError: the host process ended.
        """
        if self._channel is None:
            raise RuntimeError("no episode has begun")
        limit_s = self._limits.act_timeout_s
        deadline, late = time.monotonic() + limit_s, f"no action within {limit_s:g} s"
        question = wire.pack_observation(observation)
        payload = self._ask(wire.Frame.ACT, question, wire.Frame.ACTION, deadline, late)
        try:
            action = wire.unpack_action(payload, self._size)
        except wire.WireError as error:
            self._break_off(error)
        return fit_action(action, self._size)

    def close(self) -> None:
        """End the child and the host."""
        self._end_episode()
        self._drop_host()

    def _drop_host(self) -> None:
        self._close_channel()
        if self._host is not None:
            self._host.close()
            self._host = None

    def _close_channel(self) -> None:
        if self._channel is not None:
            self._channel.close()
            self._channel = None

    def _start(self, order: wire.StartOrder) -> None:
        """Have a child forked; a host that has ended is replaced, once."""
        for _ in range(2):
            if self._host is None:
                self._host = HostConnection(self._options.level)
            channel = self._channel = EpisodeChannel()
            try:
                limit_s = self._limits.load_timeout_s
                answer = self._host.order(order, limit_s, channel.descriptors)
                break
            except HostGoneError as error:
                problem = f"{error}: {self._host.last_line()}"
                self._drop_host()
            finally:
                channel.hand_over()
        else:
            raise errors.InfrastructureError(f"the policy's host process cannot work ({problem})")
        if "error" in answer:
            self._close_channel()
            raise REFUSALS.get(answer["class"], errors.PolicyLoadError)(answer["error"])
        channel.watch(answer["pid"])

    def _await_confined(self, deadline: float) -> None:
        """Wait for the child's first word, which it says before it looks at the checkpoint."""
        assert self._channel is not None
        text = "no answer"
        with contextlib.suppress(TimeoutError, EOFError, wire.WireError):
            kind, payload = self._channel.receive(deadline)
            if kind is wire.Frame.CONFINED:
                return
            text = wire.plain_line(payload.decode(errors="replace"))
        self._stop(0.0)
        raise errors.InfrastructureError(
            f"the policy's process could not enter its sandbox: {text}"
        )

    def _load(self, deadline: float) -> None:
        late = f"it was not loaded within {self._limits.load_timeout_s:g} s"
        try:
            answer = self._ask(wire.Frame.LOAD, b"", wire.Frame.LOADED, deadline, late)
        except errors.PolicyFaultError as fault:
            raise errors.PolicyLoadError(f"{self._target} cannot be loaded: {fault}") from fault
        self.warning = wire.plain_line(answer.decode(errors="replace"), 2 * wire.MAX_TEXT)

    def _ask(
        self, request: wire.Frame, question: bytes, wanted: wire.Frame, deadline: float, late: str
    ) -> bytes:
        """Return what the child answers, or end the child and raise what went wrong."""
        assert self._channel is not None
        began = time.monotonic()
        if began + self._left_s < deadline:
            deadline = began + self._left_s
            late = f"its episode took more than {self._limits.episode_timeout_s:g} s"
        try:
            kind, payload = self._channel.ask(request, question, deadline)
        except TimeoutError:
            self._stop(0.0)
            raise errors.PolicyTimeoutError(late) from None
        except EOFError:
            raise self._exit_error() from None
        except wire.WireError as error:
            self._break_off(error)
        self._left_s -= time.monotonic() - began
        if kind is not wanted:
            self._refuse_answer(request, kind, payload)
        # On a stream packets can come together; a packet's first byte is no printable character.
        printable = wanted is wire.Frame.LOADED and payload.decode(errors="replace").isprintable()
        if payload and wanted is not wire.Frame.ACTION and not printable:
            self._break_off(wire.WireError(f"{kind.name} with {len(payload)} bytes behind it"))
        return payload

    def _refuse_answer(self, request: wire.Frame, kind: wire.Frame, payload: bytes) -> NoReturn:
        text = wire.plain_line(payload.decode(errors="replace"), wire.MAX_TEXT + len(self._target))
        if kind is wire.Frame.REFUSED and request is wire.Frame.LOAD:
            self._stop(0.0)
            raise errors.PolicyLoadError(text)
        if kind is wire.Frame.INVALID and request is wire.Frame.ACT:
            raise errors.InvalidActionError(text)
        if kind is wire.Frame.RAISED:
            self._stop(0.0)
            raise errors.PolicyRaisedError(text)
        self._break_off(wire.WireError(f"{kind.name} is not an answer to {request.name}"))

    def _break_off(self, error: wire.WireError) -> NoReturn:
        self._stop(0.0)
        raise errors.PolicyExitError(f"the policy's process broke the protocol: {error}") from None

    def _exit_error(self) -> errors.PolicyExitError | errors.PolicyKilledError:
        """Say how a child ended that closed its pipe, and what it printed last."""
        ending = self._stop(EXIT_GRACE_S)
        if ending.killed:
            text = "the policy's process closed its connection"
        elif ending.status < 0:
            text = f"the policy's process was killed by {_signal_name(-ending.status)}"
        else:
            text = f"the policy's process exited with code {ending.status}"
        from_outside = not ending.killed and ending.status == -signal.SIGKILL
        kind = errors.PolicyKilledError if from_outside else errors.PolicyExitError
        return kind(f"{text}: {ending.last_line}" if ending.last_line else text)

    def _stop(self, grace_s: float) -> _Ending:
        """End the child.

        Raises:
            InfrastructureError: the host itself has ended.
        """
        assert self._host is not None
        channel, self._channel = self._channel, None
        try:
            if channel is not None:
                channel.hang_up()
            answer = self._host.order(wire.StopOrder(grace_s), STOP_TIMEOUT_S)
            last_line = "" if channel is None else channel.output.last_line()
            return _Ending(answer["status"], answer["killed"], last_line)
        except HostGoneError as error:
            self._drop_host()
            raise errors.InfrastructureError(
                f"the policy's host process ended ({error})"
            ) from error
        finally:
            if channel is not None:
                channel.close()

    def _end_episode(self) -> None:
        """End the last episode's child; if the host is gone, so is the child."""
        if self._host is None:
            return
        with contextlib.suppress(errors.InfrastructureError):
            self._stop(self._end_grace_s if self._channel is not None else 0.0)


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
