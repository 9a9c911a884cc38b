"""The split: one fifth held out, evenly over families, chosen by hash and by nobody."""

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from minitouch_bench.shapegen.manifest import canonical_shape_set

TRAIN, HELD_OUT = "train", "held-out"
HELD_OUT_SHARE = 0.2
SALT = "minitouch split 1"
CANONICAL_SEED, CANONICAL_COUNT = 0, 1000
GROUP = 5
"""Of so many shapes of a family in a row one is held out, outside the canonical set."""


def splits_of(seed: int | None, families: Sequence[str], digests: Sequence[str]) -> tuple[str, ...]:
    """Return the split of every shape of a set generated with a seed, or imported (None).

    A generated shape has the split of its number, whatever the set's size: nothing that the
    canonical set holds out is ever trained on in a smaller or larger one.
    """
    if seed is None:
        return split_by_hash(families, digests)
    first = _canonical_splits(families, digests) if seed == CANONICAL_SEED else ()
    return first + tuple(_numbered_splits(seed, families))[len(first) :]


def split_by_hash(families: Sequence[str], digests: Sequence[str]) -> tuple[str, ...]:
    """Return the split of every shape of a whole set from its record's digest.

    In each family the shapes whose salted hash is lowest are held out. Quotas are the family's
    fifth, rounded so that they add up to a fifth of the whole (largest remainder).
    """
    quotas = held_out_quotas({name: families.count(name) for name in sorted(set(families))})
    ranks = [_hash(digest) for digest in digests]
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


def _canonical_splits(families: Sequence[str], digests: Sequence[str]) -> tuple[str, ...]:
    """Return the splits of the first thousand shapes, or of as many as there are."""
    if len(digests) >= CANONICAL_COUNT:
        return split_by_hash(families[:CANONICAL_COUNT], digests[:CANONICAL_COUNT])
    return tuple(shape.split for shape in canonical_shape_set().shapes[: len(digests)])


def _numbered_splits(seed: int, families: Sequence[str]) -> Iterator[str]:
    """Yield the split of every shape by its number: one in each five of a family is held out."""
    seen: Counter[str] = Counter()
    for family in families:
        group, place = divmod(seen[family], GROUP)
        chosen = int(_hash(f"{seed}/{family}/{group}"), 16) % GROUP
        yield HELD_OUT if place == chosen else TRAIN
        seen[family] += 1


def _hash(text: str) -> str:
    return hashlib.sha256(f"{SALT}/{text}".encode()).hexdigest()
