"""Programs of ``torch.export``: a graph called with image and touch. It runs as exported."""

import io
import zipfile
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

# Beside what it gives, it loads dynamo: once in a host, not in every episode's process.
from torch.export.pt2_archive._package import load_pt2
from torch.utils._pytree import tree_structure

from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.policies.native import as_array, to_tensors
from minitouch_bench.policies.policy import (
    IMAGE_SHAPE,
    RECURRENT_CLASS,
    TO_REMEMBER,
    TOUCH_SHAPE,
    Observation,
    PolicySource,
)
from minitouch_bench.policies.torchscript import name_zeros
from minitouch_bench.policies.wire import describe

ARGUMENTS, RESULT = tree_structure(((0, 0), {})), tree_structure(0)
INPUTS = ((torch.uint8, (1, *IMAGE_SHAPE)), (torch.float32, (1, *TOUCH_SHAPE)))
SIGNATURE = (
    f"(image: uint8 {(1, *IMAGE_SHAPE)}, touch: float32 {(1, *TOUCH_SHAPE)}) -> action (1, A)"
)
COMPILED = "/data/aotinductor/"
"""Where a package of AOTInductor has its machine code."""


class ExportedPolicy:
    """Run ``forward(image uint8 (1, 1, H, W), touch float32 (1, 11)) -> (1, A)``."""

    def __init__(self, program: Any) -> None:
        memory = find_memory(program)
        self.warning = memory and (
            f"it has {memory} and keeps nothing from one action to the next: torch.export drops a "
            f"state that is not a buffer. {TO_REMEMBER}"
        )
        self._module = program.module()

    def reset(self, seed: int, task: str) -> None:
        """Do nothing: the program is loaded afresh, and torch is seeded, for every episode."""

    @torch.inference_mode()
    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return what the program gives."""
        return as_array(self._module(*to_tensors(observation)))


def load_exported(source: PolicySource) -> ExportedPolicy:
    """Load a program, which opens what is pickled in it.

    Raises:
        PolicyLoadError: not a file of torch.export.save, or a program of other inputs.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(source.content)) as archive:
            is_compiled = any(COMPILED in name for name in archive.namelist())
        programs = {} if is_compiled else load_pt2(io.BytesIO(source.content)).exported_programs
    except Exception as error:  # whatever is pickled in it may raise
        raise PolicyLoadError(
            f"{source.target} cannot be read by torch {torch.__version__} (export on the CPU, "
            f"write with torch.export.save): {describe(error)}"
        ) from error
    if "model" not in programs:
        what = "compiled code" if is_compiled else "no program"
        raise PolicyLoadError(
            f"{source.target} contains {what}: write it with torch.export.save(program, file)"
        )
    _check_signature(programs["model"], source.target)
    return ExportedPolicy(programs["model"])


def _check_signature(program: Any, target: str) -> None:
    names = program.graph_signature.user_inputs
    given = [node.meta.get("val") for node in program.graph.nodes if node.name in names]
    fits = (program.call_spec.in_spec, program.call_spec.out_spec) == (ARGUMENTS, RESULT) and all(
        getattr(value, "dtype", None) is dtype and _fits(value.shape, shape)
        for value, (dtype, shape) in zip(given, INPUTS, strict=True)
    )
    if not fits:
        shown = (f"{getattr(x, 'dtype', x)} {tuple(getattr(x, 'shape', ()))}" for x in given)
        raise PolicyLoadError(
            f"{target} has the inputs ({', '.join(shown)}), keywords or several results.\n"
            f"Export {SIGNATURE} with torch.export.export(module, (image, touch))"
        )


def _fits(axes: Any, wanted: tuple[int, ...]) -> bool:
    """Tell whether a shape, which may have symbols for free axes, can be the wanted one."""
    return len(axes) == len(wanted) and all(
        not isinstance(axis, int) or axis == length
        for axis, length in zip(axes, wanted, strict=True)
    )


def find_memory(program: Any) -> str:
    """Name what a program could remember with and does not: see ``torchscript.find_memory``."""
    stacks = (str(node.meta.get("nn_module_stack")) for node in program.graph.nodes)
    found = [
        f"a recurrent layer ({match[1]})" for match in map(RECURRENT_CLASS.search, stacks) if match
    ]
    found += name_zeros({**dict(program.named_buffers()), **program.constants})
    return found[0] if found and not _writes_a_buffer(program) else ""


def _writes_a_buffer(program: Any) -> bool:
    signature = program.graph_signature
    for node in program.graph.nodes:
        if not getattr(getattr(node.target, "_schema", None), "is_mutable", False):
            continue
        changed = node.args[0]
        while getattr(changed.target, "is_view", False):
            changed = changed.args[0]
        if changed.name in signature.inputs_to_buffers:
            return True
    return bool(signature.buffers_to_mutate)
