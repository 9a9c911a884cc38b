"""Images to features: where half precision is used."""

import pytest
import torch

from minitouch_bench import machine
from minitouch_bench.agents import encoding

FLAGS = "processor : 0\nflags : fpu avx512f {}\n"


@pytest.mark.parametrize(
    ("flags", "has"),
    [("", False), ("avx512_bf16", True), ("avx512_vnni", False), ("avx512_bf16 amx_bf16", True)],
)
def test_half_precision_needs_matrix_units(tmp_path, monkeypatch, flags, has):
    file = tmp_path / "cpuinfo"
    file.write_text(FLAGS.format(flags))
    monkeypatch.setattr(machine, "CPUINFO", file)
    assert encoding.has_bfloat16(torch.device("cpu")) == has
