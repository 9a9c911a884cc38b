"""Policies made by a Python callable, ``package.module:attribute``; for trusted code only."""

import inspect
import os
import sys
from collections.abc import Callable

from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.optional import look_up
from minitouch_bench.policies.policy import Checkpoint, Policy


def make_policy(factory: Callable[..., Policy], deterministic: bool) -> Policy:
    """Call a factory; its parameter ``deterministic``, if any, says not to sample."""
    try:
        asks = "deterministic" in inspect.signature(factory).parameters
    except ValueError:  # some built-in callables have no signature to look at
        asks = False
    return factory(deterministic=deterministic) if asks else factory()


def load_factory(checkpoint: Checkpoint) -> Policy:
    """Import the factory and call it.

    Raises:
        PolicyLoadError: not importable, or what it gives is not a policy.
    """
    sys.path.append(os.getcwd())  # last, so that no file there shadows an installed package
    factory = look_up(checkpoint.target)
    if not callable(factory):
        raise PolicyLoadError(f"'{checkpoint.target}' cannot be called to make a policy")
    policy = make_policy(factory, checkpoint.deterministic)
    missing = [name for name in ("reset", "act") if not callable(getattr(policy, name, None))]
    if missing:
        raise PolicyLoadError(f"what '{checkpoint.target}' makes has no {missing[0]}()")
    return policy
