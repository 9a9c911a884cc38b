"""Random streams by name, so that no estimate depends on which others are made."""

import hashlib

import numpy as np

Root = tuple[int, ...]
"""The words of a root seed."""


def stream(root: Root, *names: str) -> np.random.Generator:
    """Return the random stream of a name, such as a task and a metric, under a root seed."""
    digest = hashlib.sha256("/".join(names).encode()).digest()
    words = np.frombuffer(digest, dtype="<u4").tolist()
    return np.random.default_rng(np.random.SeedSequence([*root, *words]))
