"""A policy isolated as asked: in a process of its own, or beside the simulator.

This is the trusted side of the process, which never imports torch.
"""

import contextlib
import signal
import sys
import tempfile
from dataclasses import replace
from typing import IO, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from minitouch_bench import errors
from minitouch_bench.episode import IN_MEMORY, Observation
from minitouch_bench.policies import policy, wire
from minitouch_bench.policies.forkserver import seed_everything
from minitouch_bench.policies.formats import FORMATS
from minitouch_bench.policies.policy import (
    SANDBOXED,
    Isolation,
    IsolationOptions,
    PolicySource,
    own_faults,
)
from minitouch_bench.policies.sources import read_again
from minitouch_bench.policies.wire import EpisodeChannel, HostConnection, HostGoneError
from minitouch_bench.protocol.spec import fit_action
from minitouch_bench.text import MAX_TEXT, plain_line

EXIT_GRACE_S = 0.2
"""Time in which a process that closed its pipe must have exited, to be asked for its status."""

END_GRACE_S = {"remote": 1.0}
"""Time by kind to end an episode in good order; what only this machine holds is just killed."""

STOP_TIMEOUT_S = 10.0

READABLE_BY_FACTORIES = (
    "In the sandbox a factory can read its package, the working directory and PYTHONPATH only; for "
    "code that you trust there is --isolation process"
)
"""What is said where a factory was denied a file."""

MUCH_MEMORY_MB = 256
"""From so many MiB on, a process that was killed may have had the kernel kill it."""


class PolicyProcess:
    """Run a policy in a process that is forked afresh for every episode.

    A host process imports what the format needs once. For each episode it forks a child that
    loads the checkpoint, so nothing can be remembered from one episode to the next.
    """

    def __init__(self, source: PolicySource, options: IsolationOptions = SANDBOXED) -> None:
        self._source = source
        self._options = options
        self._limits = options.limits
        self._files: dict[str, IO[bytes]] = {}  # checkpoints as they were read first, by digest
        self._host: HostConnection | None = None
        self._channel: EpisodeChannel | None = None
        self.warning = self.target = self._kind = ""
        self._size, self._left_s = 0, 0.0

    def __enter__(self) -> "PolicyProcess":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def reset(self, seed: int, task: str) -> None:
        """Begin an episode in a fresh child.

        Raises:
            PolicyLoadError: the checkpoint cannot be loaded.
            CheckpointChangedError: its file is another one now, or cannot be read.
            IsolationError: this machine has no sandbox to hold it in.
            MissingExtraError: an optional package is not installed.
            PolicyFaultError: the policy's own ``reset`` failed; see its subclasses.
            ServerUnreachableError: there is no connection to the policy server.
            InfrastructureError: no host process can be started.
        """
        part = self._source.for_task(task)
        policy.check_permitted(part, self._options.level, trust=self._options.trust)
        self._end_episode()
        self.target, self._kind, self._size = part.target, part.kind, policy.action_size(task)
        self._left_s = self._limits.episode_timeout_s
        self._start(part, wire.StartOrder(replace(part, content=b""), task, seed))
        limit_s = self._limits.load_timeout_s
        deadline = wire.CLOCK.now() + limit_s
        try:
            self._receive(wire.Frame.CONFINED, deadline, "no answer")
        except errors.PolicyFaultError as fault:
            text = f"the policy's process could not enter its sandbox: {fault.args[0]}"
            raise errors.InfrastructureError(text) from fault
        try:
            late = f"it was not loaded within {limit_s:g} s"
            warning = self._receive(wire.Frame.LOADED, deadline, late)
        except errors.PolicyFaultError as fault:
            raise errors.PolicyLoadError(f"{self.target} cannot be loaded: {fault}") from fault
        self.warning = plain_line(warning.decode(errors="replace"), 2 * MAX_TEXT)
        self._receive(wire.Frame.READY, deadline, f"reset did not return within {limit_s:g} s")

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the policy's action, float32 of the task's size, finite, not clipped.

        Raises:
            InvalidActionError: wrong length or type, NaN or infinity.
            PolicyTimeoutError: no answer in time; the child is killed.
            PolicyExitError: the child ended; the text has its code and last line.
            PolicyKilledError: the child was killed from outside.
            OutOfMemoryError: the same, while it used much memory.
            PolicyRaisedError: the policy's code raised; the text has type and message.
            ServerUnreachableError: there is no connection to the policy server.
            InfrastructureError: the host process ended.
        """
        limit_s = self._limits.act_timeout_s
        deadline, late = wire.CLOCK.now() + limit_s, f"no action within {limit_s:g} s"
        question = wire.pack_observation(observation)
        payload = self._receive(wire.Frame.ACTION, deadline, late, question)
        if len(payload) != 4 * self._size:
            self._break_off(f"an action of {len(payload)} bytes, not {4 * self._size}")
        return fit_action(np.frombuffer(payload, np.float32), self._size)

    def close(self) -> None:
        """End the child and the host."""
        self._end_episode()
        self._drop_host()
        while self._files:
            self._files.popitem()[1].close()

    def _drop_host(self) -> None:
        for connection in (self._channel, self._host):
            if connection is not None:
                connection.close()
        self._channel = self._host = None

    def _start(self, part: PolicySource, order: wire.StartOrder) -> None:
        """Have a child forked; a host that has ended or is too slow is replaced, once."""
        setup = wire.HostSetup(part.kind, replace(self._options, private=""))
        if part.kind == "factory" and self._options.level is Isolation.SANDBOX:
            setup = wire.HostSetup(part.kind, self._options, part.target)
        if self._host is not None and self._host.setup != setup:
            self._drop_host()
        for _ in range(2):
            try:
                files = self._open_file(part)
                self._host = self._host or HostConnection(setup)
                channel = self._channel = EpisodeChannel()
            except OSError as error:  # too many files are open, or there is no memory or disk
                text = f"no process can be started for the policy: {error}"
                raise errors.InfrastructureError(text) from error
            try:
                limit_s = self._limits.load_timeout_s
                answer = self._host.order(order, limit_s, (*channel.descriptors, *files))
                break
            except HostGoneError as error:
                problem = ": ".join(filter(None, (str(error), self._host.output.last_line())))
                self._drop_host()
            finally:
                channel.hand_over()
        else:
            raise errors.InfrastructureError(f"the policy's host process cannot work ({problem})")
        if "error" in answer:
            self._drop_host()
            raise getattr(errors, answer["class"])(answer["error"])
        channel.watch(answer["pid"])

    def _open_file(self, part: PolicySource) -> tuple[int, ...]:
        """Return the descriptor of a copy of a checkpoint's file, if it has one."""
        if not FORMATS[part.kind].suffixes:
            return ()
        if part.digest not in self._files:
            content = part.content or read_again(part.target, part.digest)
            file = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as episodes need it
            file.write(content)
            file.flush()
            self._files[part.digest] = file
        return (self._files[part.digest].fileno(),)

    def _receive(
        self, wanted: wire.Frame, deadline: float, late: str, question: bytes = b""
    ) -> bytes:
        """Return what the child sends next, or end it and raise what went wrong."""
        assert self._channel is not None
        began = wire.CLOCK.now()
        if began + self._left_s < deadline:
            deadline = began + self._left_s
            late = f"its episode took more than {self._limits.episode_timeout_s:g} s"
        try:
            if question:
                kind, payload = self._channel.ask(question, deadline)
            else:
                kind, payload = self._channel.receive(deadline)
        except TimeoutError:
            self._stop(0.0)
            raise errors.PolicyTimeoutError(late) from None
        except EOFError:
            raise self._exit_error() from None
        except wire.WireError as error:
            self._break_off(str(error))
        self._left_s -= wire.CLOCK.now() - began
        if kind is not wanted:
            self._raise_failure(wanted, kind, payload)
        return payload

    def _raise_failure(self, wanted: wire.Frame, kind: wire.Frame, payload: bytes) -> NoReturn:
        is_possible = {
            wire.Frame.REFUSED: wanted in (wire.Frame.LOADED, wire.Frame.READY),
            wire.Frame.INVALID: wanted is wire.Frame.ACTION,
            wire.Frame.UNREACHABLE: self._kind == "remote",  # only our client can say so
            wire.Frame.RAISED: True,
        }
        if not is_possible.get(kind):
            self._break_off(f"{kind.name} in place of {wanted.name}")
        is_confined_factory = self._host is not None and self._host.setup.factory
        self._stop(END_GRACE_S.get(self._kind, 0.0))
        text = plain_line(payload.decode(errors="replace"), 2 * MAX_TEXT + len(self.target))
        if kind is wire.Frame.REFUSED and is_confined_factory and "PermissionError" in text:
            text += f". {READABLE_BY_FACTORIES}"
        raise wire.FAILURES[kind](text)

    def _break_off(self, problem: str) -> NoReturn:
        self._stop(0.0)
        text = f"the policy's process broke the protocol: {problem}"
        raise errors.PolicyExitError(text) from None

    def _exit_error(self) -> errors.MiniTouchError:
        """Say how a child ended that closed its pipe, and what it printed last."""
        end, last_line = self._stop(EXIT_GRACE_S)
        status, killed = end["status"], end["killed"]
        if killed:
            text = "the policy's process closed its connection"
        elif status < 0:
            names = {number.value: number.name for number in signal.Signals}
            name = names.get(-status, f"signal {-status}")
            text = f"the policy's process was killed by {name}"
        else:
            text = f"the policy's process exited with code {status}"
        if killed or status != -signal.SIGKILL:
            return errors.PolicyExitError(f"{text}: {last_line}" if last_line else text)
        if end["grown_mb"] < MUCH_MEMORY_MB:
            return errors.PolicyKilledError(text)
        text += f" while it used {end['grown_mb']:,} MiB: use fewer workers or more memory"
        return errors.OutOfMemoryError(text)

    def _stop(self, grace_s: float) -> tuple[dict[str, Any], str]:
        """End the child; return how it ended, and the last line that it printed.

        Raises:
            InfrastructureError: the host itself has ended.
        """
        assert self._host is not None
        assert self._channel is not None
        channel, self._channel = self._channel, None
        try:
            channel.hang_up()
            answer = self._host.order(grace_s, STOP_TIMEOUT_S)
            return answer, channel.output.last_line()
        except HostGoneError as error:
            self._drop_host()
            raise errors.InfrastructureError(
                f"the policy's host process ended ({error})"
            ) from error
        finally:
            channel.close()

    def _end_episode(self) -> None:
        """End the last episode's child; if the host is gone, so is the child."""
        if self._channel is not None:
            with contextlib.suppress(errors.InfrastructureError):
                self._stop(END_GRACE_S.get(self._kind, 0.0))


class InProcessPolicy:
    """Load a policy afresh for every episode, beside the simulator.

    Only for what is trusted: it can read the simulator, keep what it likes between episodes,
    hang, or end the process.
    """

    def __init__(self, source: PolicySource, *, trust: bool = False) -> None:
        self._source = source
        self._trust = trust
        self._policy: policy.Policy | None = None
        self._size = 0
        self.target = self.warning = ""

    def reset(self, seed: int, task: str) -> None:
        """End the episode before, load the policy again and begin one; raise as a process does."""
        self.close()
        part = self._source.for_task(task)
        self.target, self._size = part.target, policy.action_size(task)
        policy.check_permitted(part, Isolation.NONE, trust=self._trust)
        if FORMATS[part.kind].suffixes:
            part = replace(part, content=part.content or read_again(part.target, part.digest))
        seed_everything(seed)
        with own_faults(part.kind):
            self._policy = policy.load_policy(part)
            if "torch" in sys.modules:
                sys.modules["torch"].set_num_threads(1)
            seed_everything(seed)
            self.warning = policy.warning_of(self._policy)
            policy.begin_episode(self._policy, seed, task)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the policy's action, float32 of the task's size, finite, not clipped."""
        assert self._policy is not None
        copied = {name: value.copy() for name, value in observation.items()}
        with own_faults(self._source.kind):
            return fit_action(self._policy.act(copied), self._size)

    def close(self) -> None:
        """Forget the policy; what goes wrong at its end changes no episode."""
        ended, self._policy = self._policy, None
        with contextlib.suppress(errors.MiniTouchError), own_faults(self._source.kind):
            policy.close_policy(ended)


def effective_level(source: PolicySource, asked: Isolation) -> Isolation:
    """Return the level at which a policy runs where one was asked for.

    The scripted policy runs beside the simulator, because it reads it, and an object in memory
    because it may need what its process has. A remote policy needs the network, and its process
    runs only our own client.
    """
    if source.kind in ("scripted", IN_MEMORY):
        return Isolation.NONE
    if source.kind == "remote" and asked is Isolation.SANDBOX:
        return Isolation.PROCESS
    return asked


def isolate(
    source: PolicySource, options: IsolationOptions = SANDBOXED
) -> PolicyProcess | InProcessPolicy:
    """Return the policy of a source, isolated as asked; nothing is loaded before its reset."""
    level = effective_level(source, options.level)
    if level is Isolation.NONE:
        return InProcessPolicy(source, trust=options.trust)
    return PolicyProcess(source, replace(options, level=level))
