from hashlib import sha256

from minitouch_bench.shapegen.splits import HELD_OUT, held_out_quotas, split_of


def test_a_thousand_shapes_split_exactly_and_evenly() -> None:
    families = [f"family{i % 7}" for i in range(1000)]
    splits = split_of(families, [sha256(str(i).encode()).hexdigest() for i in range(1000)])
    assert splits.count(HELD_OUT) == 200
    held = [f for f, s in zip(families, splits, strict=True) if s == HELD_OUT]
    assert {held.count(name) for name in set(families)} <= {28, 29}


def test_quotas_add_up() -> None:
    assert sum(held_out_quotas({"a": 7, "b": 7, "c": 7}).values()) == 4


def test_the_split_follows_the_shape_not_its_place() -> None:
    digests = [sha256(str(i).encode()).hexdigest() for i in range(50)]
    forward = dict(zip(digests, split_of(["a"] * 50, digests), strict=True))
    backward = dict(zip(digests[::-1], split_of(["a"] * 50, digests[::-1]), strict=True))
    assert forward == backward
