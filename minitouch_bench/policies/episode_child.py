"""One episode of a policy, in a process that is forked for it and ends with it."""

import os
import random
import sys
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
import numpy.random  # loaded lazily otherwise, so in every child anew

from minitouch_bench.errors import MissingExtraError, PolicyLoadError, PolicyRaisedError
from minitouch_bench.policies.isolation.sandbox import Sandbox
from minitouch_bench.policies.loading import load_policy
from minitouch_bench.policies.policy import Checkpoint, Policy
from minitouch_bench.policies.wire import (
    Frame,
    WireError,
    describe,
    pack_action,
    read_frame,
    unpack_observation,
    write_frame,
)


@dataclass(frozen=True)
class Episode:
    """What a child is forked for: which policy, which task, which seed, and what holds it."""

    kind: str
    checkpoint: Checkpoint
    task: str
    seed: int
    sandbox: Sandbox | None = None


def run_episode(episode: Episode, requests: int, answers: int) -> NoReturn:
    """Load the policy, reset it, answer its acts until ``requests`` closes, then exit.

    A policy with a method ``close`` is told of the end: a server wants to know.
    """
    code = 1
    try:
        policy = _load(episode, requests, answers)
        if policy is not None and _reset(policy, episode, answers):
            _serve(policy, requests, answers)
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


def _load(episode: Episode, requests: int, answers: int) -> Policy | None:
    seed_everything(episode.seed)
    if episode.sandbox is not None:
        try:
            episode.sandbox.enter((requests, answers))
        except OSError as error:
            write_frame(answers, Frame.UNCONFINED, describe(error).encode())
            return None
    # Everything above is ours, everything below may be a stranger's.
    try:
        policy = load_policy(episode.kind, episode.checkpoint)
    except PolicyLoadError as error:
        write_frame(answers, Frame.REFUSED, str(error).encode())
        return None
    except MissingExtraError as error:
        write_frame(answers, Frame.MISSING_EXTRA, str(error).encode())
        return None
    write_frame(answers, Frame.LOADED)
    return policy


def _reset(policy: Policy, episode: Episode, answers: int) -> bool:
    try:
        seed_everything(episode.seed)  # loading may have drawn numbers
        policy.reset(episode.seed, episode.task)
    except SystemExit:
        raise
    except BaseException as error:
        write_frame(answers, Frame.RAISED, _tell(error))
        return False
    write_frame(answers, Frame.READY)
    return True


def _serve(policy: Policy, requests: int, answers: int) -> None:
    while True:
        try:
            kind, payload = read_frame(requests)
        except EOFError:
            break
        if kind is not Frame.ACT:
            raise WireError(f"a request of kind {kind}")
        observation = unpack_observation(payload)
        try:
            answer = pack_action(policy.act(observation))
        except SystemExit:
            raise
        except BaseException as error:
            write_frame(answers, Frame.RAISED, _tell(error))
        else:
            write_frame(answers, Frame.ACTION, answer)
    close = getattr(policy, "close", None)
    if callable(close):
        close()


def _tell(error: BaseException) -> bytes:
    """Return what is said of an exception; a loader's own words need no type before them."""
    text = str(error) if isinstance(error, PolicyRaisedError) else describe(error)
    return text.encode()


def _exit_code(stop: SystemExit) -> int:
    """Return the code that Python itself would exit with, and print a text as it would."""
    if stop.code is None:
        return 0
    if isinstance(stop.code, int):
        return stop.code & 0xFF
    print(stop.code, file=sys.stderr, flush=True)
    return 1
