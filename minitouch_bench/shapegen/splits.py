"""The split: exactly one fifth held out, evenly over families, chosen by hash and by nobody."""

import hashlib
from collections.abc import Mapping, Sequence

TRAIN, HELD_OUT = "train", "held-out"
HELD_OUT_SHARE = 0.2
SALT = "minitouch split 1"


def split_of(families: Sequence[str], digests: Sequence[str]) -> tuple[str, ...]:
    """Return the split of every shape from its family and its record's digest.

    In each family the shapes whose salted hash is lowest are held out. Quotas are the family's
    fifth, rounded so that they add up to a fifth of the whole (largest remainder).
    """
    quotas = held_out_quotas({name: families.count(name) for name in sorted(set(families))})
    ranks = [hashlib.sha256(f"{SALT}/{digest}".encode()).hexdigest() for digest in digests]
    held: set[int] = set()
    for name, quota in quotas.items():
        members = [i for i, family in enumerate(families) if family == name]
        held.update(sorted(members, key=lambda i: ranks[i])[:quota])
    return tuple(HELD_OUT if i in held else TRAIN for i in range(len(families)))


def held_out_quotas(counts: Mapping[str, int]) -> dict[str, int]:
    """Return how many of each family are held out; their sum is the rounded fifth of all."""
    exact = {name: count * HELD_OUT_SHARE for name, count in counts.items()}
    quotas = {name: int(value) for name, value in exact.items()}
    missing = round(sum(counts.values()) * HELD_OUT_SHARE) - sum(quotas.values())
    by_remainder = sorted(exact, key=lambda name: (quotas[name] - exact[name], name))
    for name in by_remainder[:missing]:
        quotas[name] += 1
    return quotas
