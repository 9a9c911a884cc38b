"""ONNX checkpoints: inputs ``image`` and ``touch``, output ``action``. Runs as exported."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import onnx
import onnxruntime
from numpy.typing import NDArray

from minitouch_bench.episode import Observation
from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.policies import policy
from minitouch_bench.policies.sources import declares_too_much

INPUT_SHAPES = {"image": (1, *policy.IMAGE_SHAPE), "touch": (1, *policy.TOUCH_SHAPE)}
OUTPUT = "action"
MAX_ITEM_BYTES = 16
RECURRENT = ("GRU", "LSTM", "RNN")
"""Operations of ONNX that are recurrent layers."""


class OnnxPolicy:
    """Run a graph with onnxruntime, on one thread."""

    def __init__(self, session: Any, warning: str) -> None:
        self._session = session
        self.warning = warning

    def reset(self, seed: int, task: str) -> None:
        """Do nothing: the graph is loaded afresh for every episode."""

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the graph's output ``action``."""
        feed = {name: observation[name][np.newaxis] for name in INPUT_SHAPES}
        (action,) = self._session.run([OUTPUT], feed)
        return action


def load_onnx(source: policy.PolicySource) -> OnnxPolicy:
    """Check a graph, then hand it to onnxruntime.

    Raises:
        PolicyLoadError: external data, or inputs and output of other names or shapes.
    """
    model = onnx.load_model_from_string(source.content)
    check_model(model)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(
        source.content, options, providers=["CPUExecutionProvider"]
    )
    operations = (node.op_type for node in model.graph.node if node.op_type in RECURRENT)
    recurrent = policy.find_recurrent(source.content) or next(operations, "")
    warning = recurrent and (
        f"it has a recurrent layer ({recurrent}), and an ONNX graph keeps nothing from one "
        f"action to the next. {policy.TO_REMEMBER}"
    )
    return OnnxPolicy(session, warning)


def check_model(model: onnx.ModelProto) -> None:
    """Refuse a graph that reads other files, declares too much, or has other inputs and output.

    Raises:
        PolicyLoadError: saying which.
    """
    external = onnx.TensorProto.EXTERNAL
    declared = 0
    for sparse in _messages(model, onnx.SparseTensorProto):
        declared += MAX_ITEM_BYTES * math.prod(sparse.dims)
    for tensor in _messages(model, onnx.TensorProto):
        declared += math.prod(tensor.dims)  # at least: some types pack two into a byte
        if tensor.data_location == external or tensor.external_data:
            raise PolicyLoadError("weights are in another file; export with external_data=False")
    if declares_too_much(declared // 2, model.ByteSize()):
        raise PolicyLoadError(f"it declares {declared // 2} bytes: it is not unpacked")
    weights = {tensor.name for tensor in model.graph.initializer}
    inputs = {value.name: value for value in model.graph.input if value.name not in weights}
    if set(inputs) != set(INPUT_SHAPES):
        raise PolicyLoadError(f"it has inputs {sorted(inputs)}, not ['image', 'touch']")
    types = {"image": onnx.TensorProto.UINT8, "touch": onnx.TensorProto.FLOAT}
    for name, shape in INPUT_SHAPES.items():
        tensor_type = inputs[name].type.tensor_type
        axes = [axis.dim_value or None for axis in tensor_type.shape.dim]
        if tensor_type.elem_type != types[name] or not policy.fits_shape(axes, shape):
            wanted = "uint8" if name == "image" else "float32"
            found = f"{onnx.TensorProto.DataType.Name(tensor_type.elem_type).lower()} {tuple(axes)}"
            raise PolicyLoadError(f"input '{name}' is {found}, not {wanted} {shape}")
    outputs = [value.name for value in model.graph.output]
    if OUTPUT not in outputs:
        raise PolicyLoadError(f"it has outputs {outputs}, not ['action']")


def _messages(message: Any, wanted: type) -> Iterator[Any]:
    """Yield every message of a type below a protobuf message, wherever it hides."""
    if isinstance(message, wanted):
        yield message
        return
    for field, value in message.ListFields():
        if field.message_type is None:
            continue
        children = [value] if hasattr(value, "ListFields") else value
        for child in children:
            yield from _messages(child, wanted)
