"""Modules that torch saved with their code, torch.export's and TorchScript's; they run as saved."""

import io
import warnings
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils._pytree import tree_structure

from minitouch_bench import errors
from minitouch_bench.episode import Observation
from minitouch_bench.policies import policy
from minitouch_bench.policies.native import as_array, to_tensors
from minitouch_bench.text import describe, own_place, plain_line

ARGUMENTS, RESULT = tree_structure(((0, 0), {})), tree_structure(0)
INPUTS = ((torch.uint8, (1, *policy.IMAGE_SHAPE)), (torch.float32, (1, *policy.TOUCH_SHAPE)))
SIGNATURE = f"(image: uint8 {INPUTS[0][1]}, touch: float32 {INPUTS[1][1]}) -> action (1, A)"
COMPILED = "/data/aotinductor/"
"""Where a package of AOTInductor has its machine code."""

RAN = "failed in the TorchScript interpreter"
"""What torch says where a file's code failed, and not the reading of the file."""
TORCH_ERRORS = (RuntimeError, torch.jit.Error)
"""The second is what a script raises itself."""


class ModulePolicy:
    """Run ``forward(image uint8 (1, 1, H, W), touch float32 (1, 11)) -> (1, A)``.

    ``memory`` is what the module could remember with, "" for nothing: its trial finds out whether
    it does.
    """

    def __init__(self, module: Any, memory: str = "") -> None:
        self._module = module
        self.warning = memory and (
            f"it has {memory} and keeps nothing from one action to the next: saving it drops what "
            f"forward assigns to anything but a buffer. {policy.TO_REMEMBER}"
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
            except TORCH_ERRORS as error:  # whose message begins with the whole source
                raise errors.PolicyRaisedError(_last_line(error) + own_place(error)) from error


def load_exported(source: policy.PolicySource) -> ModulePolicy:
    """Load a program of ``torch.export``, which opens what is pickled in it.

    Raises:
        PolicyLoadError: not a file of torch.export.save, or a program of other inputs.
    """
    # It loads dynamo, which only this format needs; a host has loaded it before.
    from torch.export.pt2_archive._package import load_pt2  # noqa: PLC0415

    try:
        with zipfile.ZipFile(io.BytesIO(source.content)) as archive:
            is_compiled = any(COMPILED in name for name in archive.namelist())
        programs = {} if is_compiled else load_pt2(io.BytesIO(source.content)).exported_programs
    except Exception as error:  # whatever is pickled in it may raise
        raise errors.PolicyLoadError(
            f"it cannot be read by torch {torch.__version__} (export on the CPU, write with "
            f"torch.export.save): {describe(error)}"
        ) from error
    if "model" not in programs:
        what = "compiled code" if is_compiled else "no program"
        text = f"it contains {what}: write it with torch.export.save(program, file)"
        raise errors.PolicyLoadError(text)
    program = programs["model"]
    names = program.graph_signature.user_inputs
    given = [node.meta.get("val") for node in program.graph.nodes if node.name in names]
    fits = (program.call_spec.in_spec, program.call_spec.out_spec) == (ARGUMENTS, RESULT) and all(
        getattr(value, "dtype", None) is dtype and policy.fits_shape(value.shape, shape)
        for value, (dtype, shape) in zip(given, INPUTS, strict=True)
    )
    if not fits:
        shown = (f"{getattr(x, 'dtype', x)} {tuple(getattr(x, 'shape', ()))}" for x in given)
        raise errors.PolicyLoadError(
            f"it has the inputs ({', '.join(shown)}), keywords or several results.\n"
            f"Export {SIGNATURE} with torch.export.export(module, (image, touch))"
        )
    tensors = {**dict(program.named_buffers()), **program.constants}
    return ModulePolicy(program.module(), _find_memory(source.content, tensors))


def load_torchscript(source: policy.PolicySource) -> ModulePolicy:
    """Load a TorchScript module on the CPU.

    Raises:
        PolicyLoadError: not a TorchScript file, or a forward of other arguments.
    """
    try:
        with warnings.catch_warnings():  # the format's ``advice`` says it
            warnings.filterwarnings("ignore", "`?torch.jit", DeprecationWarning)
            module = torch.jit.load(io.BytesIO(source.content), map_location="cpu")  # type: ignore[no-untyped-call]
    except (*TORCH_ERRORS, ValueError) as error:
        if RAN in str(error):
            raise errors.PolicyLoadError(f"code of its own failed: {_last_line(error)}") from error
        raise errors.PolicyLoadError(
            "not a TorchScript file. Weights alone are not enough: export the module with "
            "torch.export as .pt2, see docs/how-to/export-a-policy.md"
        ) from error
    module.eval()
    arguments = [argument.name for argument in module.forward.schema.arguments[1:]]
    if len(arguments) != 2:
        raise errors.PolicyLoadError(f"forward takes ({', '.join(arguments)}), not (image, touch)")
    return ModulePolicy(module, _find_memory(source.content, dict(module.named_buffers())))


def _last_line(error: Exception) -> str:
    """Return the end of torch's message, where it says what went wrong."""
    lines = [line for line in str(error).splitlines() if line.strip()]
    return plain_line(lines[-1]) if lines else type(error).__name__


def _find_memory(content: bytes, tensors: Mapping[str, Any]) -> str:
    """Name a recurrent layer, or a tensor of zeros, as a hidden state begins with; "" for none."""
    if layer := policy.find_recurrent(content):
        return f"a recurrent layer ({layer})"
    for name, value in tensors.items():
        is_tensor = isinstance(value, torch.Tensor) and value.numel() > 1
        if is_tensor and not (value.any() or name.endswith("running_mean")):  # of a normalization
            return f"a tensor of zeros ('{name}')"
    return ""
