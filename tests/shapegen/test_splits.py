from hashlib import sha256

import pytest

from minitouch_bench.shapegen.build import family_of
from minitouch_bench.shapegen.manifest import canonical_shape_set
from minitouch_bench.shapegen.splits import (
    HELD_OUT,
    TRAIN,
    held_out_quotas,
    split_by_hash,
    splits_of,
)


def test_a_thousand_shapes_split_exactly_and_evenly() -> None:
    families = [f"family{i % 7}" for i in range(1000)]
    splits = split_by_hash(families, [sha256(str(i).encode()).hexdigest() for i in range(1000)])
    assert splits.count(HELD_OUT) == 200
    held = [f for f, s in zip(families, splits, strict=True) if s == HELD_OUT]
    assert {held.count(name) for name in set(families)} <= {28, 29}


def test_quotas_add_up() -> None:
    assert sum(held_out_quotas({"a": 7, "b": 7, "c": 7}).values()) == 4


def test_the_split_follows_the_shape_not_its_place() -> None:
    digests = [sha256(str(i).encode()).hexdigest() for i in range(50)]
    forward = dict(zip(digests, split_by_hash(["a"] * 50, digests), strict=True))
    backward = dict(zip(digests[::-1], split_by_hash(["a"] * 50, digests[::-1]), strict=True))
    assert forward == backward


def splits_of_first(count: int, seed: int) -> tuple[str, ...]:
    """Return the splits of the first shapes of a seed; their records matter in seed 0 alone."""
    canonical = canonical_shape_set().shapes
    digests = [canonical[i].digest if i < 1000 else str(i) for i in range(count)]
    return splits_of(seed, [family_of(i) for i in range(count)], digests)


def test_the_canonical_set_follows_the_rule() -> None:
    assert splits_of_first(1000, 0) == tuple(s.split for s in canonical_shape_set().shapes)


@pytest.mark.parametrize("seed", [0, 7])
def test_a_shape_keeps_its_split_whatever_the_size_of_its_set(seed: int) -> None:
    whole = splits_of_first(1200, seed)
    for count in (1, 40, 999, 1000, 1001):
        assert splits_of_first(count, seed) == whole[:count]


def test_other_seeds_hold_out_one_in_five_of_each_family_at_other_places() -> None:
    found = {seed: splits_of_first(400, seed) for seed in (1, 2)}
    assert found[1] != found[2]
    for splits in found.values():
        for family in range(8):
            assert splits[family::8].count(HELD_OUT) == 10
        # The place within five is not always the same one.
        assert len({splits[start : start + 40 : 8].index(HELD_OUT) for start in range(8)}) > 1


def test_an_imported_set_is_split_as_a_whole() -> None:
    splits = splits_of(None, ["imported"] * 50, [str(i) for i in range(50)])
    assert (splits.count(HELD_OUT), splits.count(TRAIN)) == (10, 40)
