"""What a policy is, how it is isolated, and how it is loaded."""

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Observation, PolicyIdentity
from minitouch_bench.errors import (
    MissingExtraError,
    PolicyError,
    PolicyFaultError,
    PolicyLoadError,
    PolicyRaisedError,
    ServerUnreachableError,
    UsageError,
)
from minitouch_bench.machine import look_up, require
from minitouch_bench.policies.formats import FORMATS
from minitouch_bench.protocol.limits import USUAL_LIMITS, PolicyLimits
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.text import MAX_TEXT, describe, plain_line

IMAGE_SHAPE, TOUCH_SHAPE = PROTOCOL.observation.image_shape, (PROTOCOL.observation.touch_size,)


class Policy(Protocol):
    """Anything that can be evaluated.

    Where its loader found something that its author should know, it has a text ``warning``.
    """

    def reset(self, seed: int, task: str) -> None:
        """Begin an episode of a task; the seed is the episode's only source of chance."""

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the action, float32 (4,) or (5,), each number in [-1, 1]: see ``fit_action``."""


def begin_episode(policy: Policy, seed: int, task: str) -> None:
    """Reset a new policy, if it has a method ``reset``: an object in memory may do without."""
    if callable(reset := getattr(policy, "reset", None)):
        reset(seed, task)


def close_policy(policy: Policy | None) -> None:
    """Tell a policy of the end of its episode, if it has a method ``close``: a server wants it."""
    if callable(close := getattr(policy, "close", None)):
        close()


def warning_of(policy: Policy) -> str:
    """Return what a policy's loader warns of, "" for nothing, in one line."""
    warning = getattr(policy, "warning", "")
    return plain_line(warning, 2 * MAX_TEXT) if isinstance(warning, str) else ""


TO_REMEMBER = (
    "If it should remember, keep its state in a buffer that forward writes in place, and save it "
    "with torch.export (.pt2)"
)
"""What a loader advises that finds a memory without a state."""

RECURRENT_CLASS = re.compile(rb"torch\.nn\.modules\.rnn(?:\.___torch_mangle_\d+)?[.\n](\w+)")
"""How a file of TorchScript, torch.export or ONNX names the class of a recurrent layer."""

DIRECTORY = "directory"
"""The kind of a policy that is one file per task."""

NOTES = {"scripted": ("reads the simulator's state",), "remote": ("remote",)}
"""Labels by kind, which every table shows."""


@dataclass(frozen=True)
class PolicySource:
    """A policy as it was named, found and readable: what can be sent to another process.

    The ``Policy`` that acts cannot: it has a session, a connection or a running process.

    ``target`` is the file, the factory or the URL. ``digest`` is the SHA-256 of the file's bytes
    or of an object in memory, otherwise "". A directory has ``parts``, one source per task.
    ``content`` is the bytes of a policy that is in memory, and for a loader those of the file.
    ``address`` is what a run records in place of ``target``, where that is a cached copy. A policy
    that is not ``deterministic`` may sample its actions.
    """

    kind: str
    name: str
    target: str
    digest: str = ""
    parts: tuple[tuple[str, "PolicySource"], ...] = ()
    content: bytes = field(default=b"", repr=False)
    address: str = ""
    deterministic: bool = True

    def for_task(self, task: str) -> "PolicySource":
        """Return the source that serves a task.

        Raises:
            PolicyLoadError: the directory has no file for it.
        """
        if self.kind != DIRECTORY:
            return self
        part = dict(self.parts).get(task)
        if part is None:
            raise PolicyLoadError(
                f"{self.target} has no policy for the task '{task}': add a file such as "
                f"{task}.safetensors, or a training of the task"
            )
        return replace(part, deterministic=self.deterministic)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Its kind, or those of its parts, each once."""
        return tuple(dict.fromkeys(part.kind for _, part in self.parts)) or (self.kind,)

    def identity(self) -> PolicyIdentity:
        """Return what a run records of the policy."""
        notes = tuple(note for kind in self.kinds for note in NOTES.get(kind, ()))
        address = self.address or self.target
        return PolicyIdentity(self.name, address, self.kind, self.digest, notes)


def find_recurrent(content: bytes) -> str:
    """Return the class of a recurrent layer of torch that a file names, "" for none."""
    match = RECURRENT_CLASS.search(content)
    return match[1].decode() if match else ""


def fits_shape(axes: Sequence[object], wanted: tuple[int, ...]) -> bool:
    """Tell whether a file's shape, in which a free axis is not a number, can be the wanted one."""
    return len(axes) == len(wanted) and all(
        not isinstance(axis, int) or axis == length
        for axis, length in zip(axes, wanted, strict=True)
    )


def action_size(task: str) -> int:
    """Return how many numbers an action of the task has."""
    return PROTOCOL.task(task).action_size


def zero_observation() -> dict[str, NDArray[Any]]:
    """Return a black image and an all-zero touch vector."""
    return {"image": np.zeros(IMAGE_SHAPE, np.uint8), "touch": np.zeros(TOUCH_SHAPE, np.float32)}


class Isolation(StrEnum):
    """The levels of isolation, strictest first."""

    SANDBOX = "sandbox"
    """A process of its own that can reach neither files, network nor other processes."""

    PROCESS = "process"
    """A process of its own, with all the rights of the user who runs the evaluation."""

    NONE = "none"
    """The process of the simulator, for debugging."""


@dataclass(frozen=True)
class IsolationOptions:
    """How to isolate a policy. ``trust`` permits Python code that comes with it.

    ``private`` is the run's directory, which a policy must not read: "" where there is none.
    """

    level: Isolation = Isolation.SANDBOX
    trust: bool = False
    limits: PolicyLimits = USUAL_LIMITS
    private: str = ""


SANDBOXED = IsolationOptions()
"""The default."""


def isolation_options(
    isolation: str,
    trust: bool,
    act_timeout: float = USUAL_LIMITS.act_timeout_s,
    episode_timeout: float = USUAL_LIMITS.episode_timeout_s,
) -> IsolationOptions:
    """Return how to isolate a policy.

    Raises:
        UsageError: there is no such level, or a time cannot be waited for.
    """
    if isolation not in tuple(Isolation):
        raise UsageError(f"no isolation '{isolation}'; it is one of {', '.join(Isolation)}")
    limits = PolicyLimits(act_timeout_s=act_timeout, episode_timeout_s=episode_timeout)
    return IsolationOptions(Isolation(isolation), trust, limits)


def check_permitted(source: PolicySource, isolation: Isolation, *, trust: bool) -> None:
    """Refuse a policy that would run code of its own where nothing holds it.

    Raises:
        PolicyLoadError: it is neither in the sandbox nor trusted.
    """
    is_factory, is_confined = source.kind == "factory", isolation is Isolation.SANDBOX
    if not trust and (is_factory or (FORMATS[source.kind].runs_code and not is_confined)):
        leave = "" if is_factory else "Leave it to --isolation sandbox. "
        raise PolicyLoadError(
            f"{source.target} can run code of its own on this machine.\n"
            f"{leave}If you trust it, add --trust"
        )


def find_loader(kind: str) -> Callable[[PolicySource], Policy]:
    """Import what a kind needs and return its loader.

    Raises:
        MissingExtraError: an optional package of the format is not installed.
    """
    for module, extra in FORMATS[kind].packages:
        require(module, extra)
    return look_up(f"minitouch_bench.policies.{FORMATS[kind].loader}")


@contextmanager
def own_faults(kind: str) -> Iterator[None]:
    """Convert whatever a policy raises in the block to its fault: ``SystemExit`` is one, too.

    What it prints goes to standard error: standard output is for the results.
    """
    try:
        with redirect_stdout(sys.stderr):
            yield
    except (PolicyError, MissingExtraError, KeyboardInterrupt):
        raise
    except BaseException as error:
        # Our client of a policy server found nobody: only it can say so, no policy.
        if kind == "remote" and isinstance(error, ServerUnreachableError):
            raise
        raise PolicyRaisedError(describe(error)) from error


def load_policy(source: PolicySource) -> Policy:
    """Build the policy of a source, whose ``content`` is the file's bytes.

    Raises:
        PolicyLoadError: the checkpoint is unreadable, unsafe or of the wrong form; loaders say in
            what respect, and here the name of the file is added.
        MissingExtraError: an optional package of the format is not installed.
        ServerUnreachableError: the policy is a server, and there is no connection to it.
    """
    try:
        with own_faults(source.kind):
            return find_loader(source.kind)(source)
    except PolicyFaultError as error:
        text = f"{source.target}: not a readable {source.kind} policy: {error.args[0]}"
        raise PolicyLoadError(text) from error
    except PolicyLoadError as error:
        raise PolicyLoadError(f"{source.target}: {error}") from error
