import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from minitouch_bench.policies.policy import Policy, PolicySource, load_policy
from tests.policies.recipes import run_recipes

os.environ["ORT_DISABLE_TELEMETRY"] = "1"  # policy processes have it set for them


@pytest.fixture(scope="session")
def observation() -> dict[str, Any]:
    generator = np.random.default_rng(3)
    return {
        "image": generator.integers(0, 256, (1, 84, 84), np.uint8),
        "touch": generator.normal(0.0, 1.0, 11).astype(np.float32),
    }


@pytest.fixture(scope="session")
def light(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with the native, torch.export and TorchScript recipes' files, of one network."""
    directory = tmp_path_factory.mktemp("light")
    torch.manual_seed(5)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "`?torch.jit", DeprecationWarning)
        run_recipes(directory, "save_native(", "torch.export.save(", "torch.jit.trace(")
    return directory


@pytest.fixture(scope="session")
def onnx_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ONNX recipe's file, of the same network as the light ones."""
    pytest.importorskip("onnxscript")
    directory = tmp_path_factory.mktemp("onnx")
    torch.manual_seed(5)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's own, and many
        run_recipes(directory, "torch.onnx.export(")
    return directory / "policy.onnx"


def load(kind: str, path: Path) -> Policy:
    return load_policy(PolicySource(kind, "x", str(path), content=path.read_bytes()))
