"""A cache for every test alone, and a small set."""

from pathlib import Path
from typing import Any

import pytest
import torch  # noqa: F401  torch.jit.trace never returns if coacd is imported first

from minitouch_bench.shapegen.generate import write_set
from minitouch_bench.shapegen.manifest import canonical_shape_set


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINITOUCH_CACHE", str(tmp_path / "cache"))


def entry_of(index: int) -> dict[str, Any]:
    """Return what the canonical manifest says of a shape, without what its set gives it."""
    entry = canonical_shape_set().document["shapes"][index]
    return {k: v for k, v in entry.items() if k not in ("split", "offset", "length")}


def subset(folder: Path, count: int) -> Path:
    """Write a set of the first canonical shapes."""
    made = [(entry_of(i), canonical_shape_set().shapes[i].record()) for i in range(count)]
    folder.mkdir()
    write_set(folder, {"name": "small", "generator": 1, "seed": 0}, made)
    return folder


@pytest.fixture
def small_set(tmp_path: Path) -> Path:
    """Return the folder of a set of sixteen shapes."""
    return subset(tmp_path / "set", 16)
