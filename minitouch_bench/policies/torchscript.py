"""TorchScript checkpoints: a module called with image and touch. It runs as exported."""

import io
import warnings
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.policies.native import as_array, to_tensors
from minitouch_bench.policies.policy import Checkpoint, Observation


class TorchScriptPolicy:
    """Run ``forward(image uint8 (1, 1, 84, 84), touch float32 (1, 11)) -> (1, A)``."""

    def __init__(self, module: Any) -> None:
        self._module = module

    def reset(self, seed: int, task: str) -> None:
        """Do nothing: the module is loaded afresh, and torch is seeded, for every episode."""

    @torch.inference_mode()
    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return what the module gives."""
        # The optimising executor rewrites the graph after two calls, which costs seconds and
        # can change the last bit within an episode.
        with torch.jit.optimized_execution(False):  # type: ignore[attr-defined]
            return as_array(self._module(*to_tensors(observation)))


def load_torchscript(checkpoint: Checkpoint) -> TorchScriptPolicy:
    """Load a TorchScript module on the CPU.

    Raises:
        PolicyLoadError: no TorchScript file, or a forward of other arguments.

    """
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "`?torch.jit", DeprecationWarning)
            module = torch.jit.load(io.BytesIO(checkpoint.content), map_location="cpu")  # type: ignore[no-untyped-call]
    except (RuntimeError, ValueError) as error:
        raise PolicyLoadError(
            f"{checkpoint.target} is no TorchScript file. Weights alone are not enough: "
            "save a module with torch.jit.trace(...).save, or use .safetensors"
        ) from error
    module.eval()
    arguments = [argument.name for argument in module.forward.schema.arguments[1:]]
    if len(arguments) != 2:
        raise PolicyLoadError(
            f"{checkpoint.target}: forward takes ({', '.join(arguments)}), not (image, touch)"
        )
    return TorchScriptPolicy(module)
