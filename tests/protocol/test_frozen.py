"""The digests of ``minitouch-v1``: they never change. Another rule is another protocol."""

from minitouch_bench.protocol.minitouch import PROTOCOL

FROZEN = {
    ("table4", "playing"): "7f88a4ca6b546f33c85f16d7c797e4b30d383e1ae9254a55f41a869020cdd883",
    ("table4", "pushing"): "1c1d6d6b098b1af5f0a27f6a8ed27be1286c7e17f0126d2b580e0e87d12d231c",
    ("table4", "opening"): "56d5940dc7980e286a478aacaaf0b735118b57717bb03dde7e2c726deede5eef",
    ("table4", "pick-up"): "7c005cb3f8d02a698658ba4a1243277fd2fa67a79497c1aa724b5d72f58b882a",
    ("novel-shapes", "playing"): "4816dd51a66188e2efd6ac58b2bbcb019cd9e7ab75d785d2b22dd5696c9cef17",
    ("novel-shapes", "pushing"): "35a3e6b3af92bf379ade45f50da18a7309e27a058284becff67deac478ad8b14",
    ("novel-shapes", "pick-up"): "7c005cb3f8d02a698658ba4a1243277fd2fa67a79497c1aa724b5d72f58b882a",
}
WHOLE = "6f2973f9951733588d0c8c10f2d78ae16d250a00477cba67a5a8bbc4068a3f98"


def test_the_protocol_is_frozen():
    assert PROTOCOL.name == "minitouch-v1"
    found = {key: PROTOCOL.task_digest(key[1], key[0]) for key in FROZEN}
    assert found == FROZEN, "runs that others have made would be void: make it minitouch-v2"
    assert PROTOCOL.digest() == WHOLE
