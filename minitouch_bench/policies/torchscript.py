"""TorchScript checkpoints: a module called with image and touch. It runs as exported."""

import io
import warnings
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from minitouch_bench.errors import PolicyLoadError, PolicyRaisedError
from minitouch_bench.policies.native import as_array, to_tensors
from minitouch_bench.policies.policy import TO_REMEMBER, Observation, PolicySource
from minitouch_bench.policies.wire import plain_line

RAN = "failed in the TorchScript interpreter"
"""What torch says where a file's code failed, and not the reading of the file."""

RECURRENT = ("GRU", "GRUCell", "LSTM", "LSTMCell", "RNN", "RNNCell")
"""Names of torch's recurrent modules, which a saved module keeps."""

VIEWS = ("aten::select", "aten::slice", "aten::view", "aten::reshape", "aten::narrow")
"""Operations that return a part of the tensor that they are given, not a copy."""


def last_line(error: Exception) -> str:
    """Return the end of torch's message, where it says what went wrong."""
    lines = [line for line in str(error).splitlines() if line.strip()]
    return plain_line(lines[-1]) if lines else type(error).__name__


class TorchScriptPolicy:
    """Run ``forward(image uint8 (1, 1, H, W), touch float32 (1, 11)) -> (1, A)``."""

    def __init__(self, module: Any) -> None:
        self._module = module
        memory = find_memory(module) if isinstance(module, torch.jit.ScriptModule) else ""
        self.warning = memory and (
            f"it has {memory} and keeps nothing from one action to the next: torch.jit.trace "
            f"drops what forward assigns. {TO_REMEMBER}"
        )

    def reset(self, seed: int, task: str) -> None:
        """Do nothing: the module is loaded afresh, and torch is seeded, for every episode."""

    @torch.inference_mode()
    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return what the module gives."""
        # The optimizing executor rewrites the graph after two calls, which costs seconds and
        # can change the last bit within an episode.
        with torch.jit.optimized_execution(False):  # type: ignore[attr-defined]
            try:
                return as_array(self._module(*to_tensors(observation)))
            except RuntimeError as error:  # whose message begins with the whole source
                raise PolicyRaisedError(last_line(error)) from error


def load_torchscript(source: PolicySource) -> TorchScriptPolicy:
    """Load a TorchScript module on the CPU.

    Raises:
        PolicyLoadError: not a TorchScript file, or a forward of other arguments.
    """
    try:
        with warnings.catch_warnings():  # the format's ``advice`` says it
            warnings.filterwarnings("ignore", "`?torch.jit", DeprecationWarning)
            module = torch.jit.load(io.BytesIO(source.content), map_location="cpu")  # type: ignore[no-untyped-call]
    except (RuntimeError, ValueError) as error:
        if RAN in str(error):
            raise PolicyLoadError(
                f"{source.target} failed in code of its own: {last_line(error)}"
            ) from error
        raise PolicyLoadError(
            f"{source.target} is not a TorchScript file. Weights alone are not enough: "
            "export the module with torch.export as .pt2, see docs/how-to/export-a-policy.md"
        ) from error
    module.eval()
    arguments = [argument.name for argument in module.forward.schema.arguments[1:]]
    if len(arguments) != 2:
        raise PolicyLoadError(
            f"{source.target}: forward takes ({', '.join(arguments)}), not (image, touch)"
        )
    return TorchScriptPolicy(module)


def find_memory(module: Any) -> str:
    """Name what a module could remember with, where its ``forward`` writes to no attribute.

    It is a recurrent layer, or a tensor of zeros as a hidden state begins with. "": there is none,
    or ``forward`` writes.
    """
    kinds = [part.original_name for part in module.modules()]
    found = [f"a recurrent layer ({kind})" for kind in kinds if kind in RECURRENT]
    found += name_zeros(dict(module.named_buffers()))
    return "" if not found or any(map(_writes, _nodes(module.inlined_graph))) else found[0]


def name_zeros(tensors: Mapping[str, Any]) -> list[str]:
    """Name the tensors that are all zeros, but for those of a normalization."""
    return [
        f"a tensor of zeros ('{name}')"
        for name, value in tensors.items()
        if isinstance(value, torch.Tensor)
        and value.numel() > 1
        and not (value.any() or name.endswith("running_mean"))
    ]


def _nodes(block: Any) -> Iterator[Any]:
    for node in block.nodes():
        yield node
        for inner in node.blocks():
            yield from _nodes(inner)


def _writes(node: Any) -> bool:
    """Tell whether a node of a graph changes an attribute of its module."""
    if not node.kind().endswith("_"):
        return bool(node.kind() == "prim::SetAttr")
    changed = next(node.inputs()).node()
    while changed.kind() in VIEWS:
        changed = next(changed.inputs()).node()
    return bool(changed.kind() == "prim::GetAttr")
