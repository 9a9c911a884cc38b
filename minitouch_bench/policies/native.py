"""Native checkpoints: a safetensors file whose metadata says what the weights are."""

import json
import struct
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import safetensors.torch
import torch
from numpy.typing import NDArray
from torch import Tensor

from minitouch_bench.episode import Observation
from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.files import write_file
from minitouch_bench.policies import networks
from minitouch_bench.policies.policy import IMAGE_SHAPE, PolicySource
from minitouch_bench.protocol.spec import ACTION_SIZES
from minitouch_bench.text import describe

METADATA_KEY = "minitouch"


@dataclass(frozen=True)
class PolicyMetadata:
    """Whose weights these are, and the shape of the images that they were trained on.

    ``encoder_width`` scales the encoder's channels: see ``networks.VisualEncoder``.
    """

    architecture: str
    action_size: Annotated[int, msgspec.Meta(ge=min(ACTION_SIZES), le=max(ACTION_SIZES))]
    image_shape: tuple[int, ...]
    encoder_width: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]


class NativePolicy:
    """Run an actor, one observation at a time."""

    def __init__(self, actor: networks.TouchActor, deterministic: bool) -> None:
        self._actor = actor.eval()
        self._deterministic = deterministic
        self._generator = torch.Generator()

    def reset(self, seed: int, task: str) -> None:
        """Seed the actor's noise."""
        self._generator.manual_seed(seed)

    @torch.inference_mode()
    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the actor's action, float32 (A,)."""
        image, touch = to_tensors(observation)
        if self._deterministic:
            action = self._actor(image, touch)
        else:
            action = self._actor.sample(image, touch, self._generator)
        return as_array(action[0])


def to_tensors(observation: Observation) -> tuple[Tensor, Tensor]:
    """Return image uint8 (1, 1, H, W) and touch float32 (1, 11)."""
    image = torch.from_numpy(observation["image"]).unsqueeze(0)
    touch = torch.from_numpy(observation["touch"]).unsqueeze(0)
    return image, touch


def as_array(action: Tensor) -> NDArray[Any]:
    """Return a tensor's numbers as an array of the same type and shape."""
    return action.detach().numpy()


def save_native(actor: networks.TouchActor, path: Path) -> None:
    """Write an actor as a native checkpoint, weights in half precision where that is exact."""
    assert isinstance(actor.encoder, networks.VisualEncoder | networks.KeypointEncoder)
    form = PolicyMetadata(actor.architecture, actor.action_size, IMAGE_SHAPE, actor.encoder.width)
    tensors = {
        name: (half if torch.equal((half := value.half()).float(), value) else value).contiguous()
        for name, value in actor.state_dict().items()
    }
    write_file(path, safetensors.torch.save(tensors, {METADATA_KEY: json.dumps(asdict(form))}))


def load_native(source: PolicySource) -> NativePolicy:
    """Build the actor that the file's metadata names and fill in its weights.

    Raises:
        PolicyLoadError: no such architecture, or trained on other images.
    """
    tensors = safetensors.torch.load(source.content)
    form = _read_form(source.content)
    with torch.device("meta"):  # shapes only: random weights would be drawn for nothing
        actor = networks.ARCHITECTURES[form.architecture](form.action_size, form.encoder_width)
    actor.load_state_dict({name: value.float() for name, value in tensors.items()}, assign=True)
    return NativePolicy(actor, source.deterministic)


def _read_form(content: bytes) -> PolicyMetadata:
    (length,) = struct.unpack_from("<Q", content)
    header = json.loads(content[8 : 8 + length])  # which safetensors has checked
    try:
        form = msgspec.json.decode(header["__metadata__"][METADATA_KEY], type=PolicyMetadata)
    except (ValueError, KeyError, RecursionError) as error:
        raise PolicyLoadError(
            f"not a native checkpoint by the entry '{METADATA_KEY}' of its metadata "
            f"({describe(error)}). Write it with minitouch_bench.policies.native.save_native; of a "
            "LeRobot policy, give the directory"
        ) from error
    if form.architecture not in networks.ARCHITECTURES:
        known = ", ".join(networks.ARCHITECTURES)
        raise PolicyLoadError(f"it has the architecture {form.architecture!r}; known: {known}")
    if form.image_shape != IMAGE_SHAPE:
        text = f"it was trained on images of shape {form.image_shape}, not {IMAGE_SHAPE}"
        raise PolicyLoadError(text)
    return form
