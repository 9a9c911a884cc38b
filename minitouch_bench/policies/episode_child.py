"""One episode of a policy, in a process that is forked for it and ends with it."""

import os
import random
import sys
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
import numpy.random  # loaded lazily otherwise, so again in every child

from minitouch_bench.errors import MiniTouchError, PolicyRaisedError
from minitouch_bench.policies.isolation.sandbox import Sandbox
from minitouch_bench.policies.loading import load_policy
from minitouch_bench.policies.policy import Checkpoint
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


@dataclass(frozen=True)
class Episode:
    """What a child is forked for: which policy, which task, which seed, and what holds it."""

    kind: str
    checkpoint: Checkpoint
    task: str
    seed: int
    sandbox: Sandbox | None = None


def run_episode(episode: Episode, requests: int, answers: int) -> NoReturn:
    """Confine this process, answer requests until they close, then exit.

    A policy with a method ``close`` is told of the end: a server wants to know.
    """
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
    close = getattr(policy, "close", None)
    if callable(close):
        close()


def _exit_code(stop: SystemExit) -> int:
    """Return the code that Python itself would exit with, and print a text as it would."""
    if stop.code is None:
        return 0
    if isinstance(stop.code, int):
        return stop.code & 0xFF
    print(stop.code, file=sys.stderr, flush=True)
    return 1
