"""The digests of ``minitouch-v1``: they never change. Another rule is another protocol."""

from minitouch_bench.protocol.minitouch import PROTOCOL

FROZEN = {
    ("table4", "playing"): "7f88a4ca6b546f33c85f16d7c797e4b30d383e1ae9254a55f41a869020cdd883",
    ("table4", "pushing"): "1c1d6d6b098b1af5f0a27f6a8ed27be1286c7e17f0126d2b580e0e87d12d231c",
    ("table4", "opening"): "56d5940dc7980e286a478aacaaf0b735118b57717bb03dde7e2c726deede5eef",
    ("table4", "pick-up"): "6d996f8229e64a7b871ec42cd1a6df170ea81fee2e96a987924a9b98afbc6342",
    ("novel-shapes", "playing"): "5c3356db9afcca2fea2743e4c72667a0c08e588273191214b58d2456548a2675",
    ("novel-shapes", "pushing"): "3216ff29fb4f883932fd75ae06c4588aced7728ea3715cc375c860a38d989de4",
    ("novel-shapes", "pick-up"): "6d996f8229e64a7b871ec42cd1a6df170ea81fee2e96a987924a9b98afbc6342",
    ("dark", "playing"): "9f872e6e6a70118ea3bc698543451086635b0806224cd80d43bdf8b249c4645d",
    ("dark", "opening"): "11738db599ebe184647bcbec6b13014a49308d7e9c61f8f12b92a0f1b7970fcf",
    ("dark", "pick-up"): "58099bd4895feb8f8d730629202c8f785c3d514a2522b556bfc6c3dbe4dc58f4",
}
WHOLE = "351c5de15264c91fa895b867ea14dba19161dd0911361e61941d152a6e884114"


def test_the_protocol_is_frozen():
    assert PROTOCOL.name == "minitouch-v1"
    found = {key: PROTOCOL.task_digest(key[1], key[0]) for key in FROZEN}
    assert found == FROZEN, "runs that others have made would be void: make it minitouch-v2"
    assert PROTOCOL.digest() == WHOLE
