"""Run a policy isolated as asked, and try it once before a run."""

import contextlib
import random
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import IN_MEMORY
from minitouch_bench.errors import (
    InfrastructureError,
    MiniTouchError,
    PolicyFaultError,
    PolicyLoadError,
    PolicyRaisedError,
)
from minitouch_bench.policies.forkserver import seed_everything
from minitouch_bench.policies.policy import (
    FORMATS,
    SANDBOXED,
    Checkpoint,
    Isolation,
    IsolationOptions,
    Observation,
    Policy,
    action_size,
    check_permitted,
    close_policy,
    load_policy,
    warning_of,
    zero_observation,
)
from minitouch_bench.policies.process import PolicyProcess
from minitouch_bench.policies.sources import PolicySource, read_again
from minitouch_bench.policies.wire import describe
from minitouch_bench.tasks.action import fit_action

MAX_TRIALS = 3
"""A policy is tried this often where something other than the policy fails."""


class InProcessPolicy:
    """Load a policy afresh for every episode, beside the simulator.

    Only for what is trusted: it can read the simulator, keep what it likes between episodes,
    hang, or end the process.
    """

    def __init__(
        self, source: PolicySource, *, deterministic: bool = True, trust: bool = False
    ) -> None:
        self._source = source
        self._deterministic = deterministic
        self._trust = trust
        self._policy: Policy | None = None
        self._size = 0
        self.warning = ""

    def reset(self, seed: int, task: str) -> None:
        """End the episode before, load the policy again and begin an episode.

        Raises:
            PolicyLoadError: the checkpoint cannot be loaded, or is not trusted.
            MissingExtraError: an optional package is not installed.
            PolicyRaisedError: the policy's own ``reset`` raised.
        """
        self.close()
        part = self._source.for_task(task)
        check_permitted(part.kind, part.target, Isolation.NONE, trust=self._trust)
        content = part.content
        if FORMATS[part.kind].suffixes:
            content = read_again(part.target, part.digest)
        checkpoint = Checkpoint(part.target, content, self._deterministic)
        self._size = action_size(task)
        seed_everything(seed)
        self._policy = load_policy(part.kind, checkpoint)
        self.warning = warning_of(self._policy)
        if "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(1)
        seed_everything(seed)
        try:
            self._policy.reset(seed, task)
        except Exception as error:
            raise PolicyRaisedError(describe(error)) from error

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the policy's action, float32 of the task's size, finite, not clipped.

        Raises:
            InvalidActionError: wrong length or type, NaN or infinity.
            PolicyRaisedError: the policy's code raised.
        """
        if self._policy is None:
            raise RuntimeError("no episode has begun")
        copied = {name: value.copy() for name, value in observation.items()}
        try:
            raw = self._policy.act(copied)
        except MiniTouchError:
            raise
        except Exception as error:
            raise PolicyRaisedError(describe(error)) from error
        return fit_action(raw, self._size)

    def close(self) -> None:
        """Forget the policy; what goes wrong at its end changes no episode."""
        policy, self._policy = self._policy, None
        with contextlib.suppress(Exception):
            close_policy(policy)


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
    source: PolicySource, options: IsolationOptions = SANDBOXED, *, deterministic: bool = True
) -> PolicyProcess | InProcessPolicy:
    """Return the policy of a source, isolated as asked; nothing is loaded before its reset."""
    level = effective_level(source, options.level)
    if level is Isolation.NONE:
        return InProcessPolicy(source, deterministic=deterministic, trust=options.trust)
    return PolicyProcess(source, replace(options, level=level), deterministic=deterministic)


def try_policy(
    source: PolicySource,
    tasks: Sequence[str],
    options: IsolationOptions = SANDBOXED,
    *,
    deterministic: bool = True,
) -> tuple[str, ...]:
    """Load every checkpoint of a source once and ask for an action, whose faults are passed over.

    Returns:
        What loaders warn of, one line each.

    Raises:
        PolicyLoadError: it cannot be loaded or reset.
        IsolationError: this machine cannot isolate it as asked.
        MissingExtraError: an optional package is not installed.
        InfrastructureError: its process or its host was killed again and again.
    """
    if source.kind == "scripted":
        return ()
    first_task = {source.for_task(task): task for task in reversed(tasks)}
    for trial in range(1, MAX_TRIALS + 1):
        try:
            with (
                _kept_generators(),
                contextlib.closing(isolate(source, options, deterministic=deterministic)) as policy,
            ):
                warnings = [_try_once(policy, *item) for item in first_task.items()]
        except InfrastructureError:  # its host was killed, say
            if trial == MAX_TRIALS:
                raise
        else:
            return tuple(filter(None, warnings))
    raise AssertionError("the last trial raises")


@contextlib.contextmanager
def _kept_generators() -> Iterator[None]:
    """Leave the caller's generators and number of threads as they are: it may be a training."""
    states = random.getstate(), np.random.get_state()  # noqa: NPY002 - what a policy may use
    torch = sys.modules.get("torch")
    threads = torch.get_num_threads() if torch else 0
    devices = range(torch.cuda.device_count()) if torch and torch.cuda.is_initialized() else ()
    with torch.random.fork_rng(devices) if torch else contextlib.nullcontext():
        try:
            yield
        finally:
            random.setstate(states[0])
            np.random.set_state(states[1])  # noqa: NPY002
            if torch:
                torch.set_num_threads(threads)


def _try_once(policy: PolicyProcess | InProcessPolicy, part: PolicySource, task: str) -> str:
    """Load a checkpoint and ask for an action; return what its loader warns of."""
    try:
        policy.reset(0, task)
    except PolicyFaultError as fault:
        raise PolicyLoadError(f"{part.target} cannot be reset: {fault}") from fault
    with contextlib.suppress(PolicyFaultError):
        policy.act(zero_observation())
    return f"{part.target}: {policy.warning}" if policy.warning else ""
