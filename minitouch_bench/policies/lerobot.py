"""LeRobot's checkpoints: directories of JSON and safetensors, which are data and run no code.

One travels to the policy's process, and into a submission, as one file: a tar of what is read of
the directory. The sandbox needs no folder for it, and its SHA-256 is the policy's digest.
"""

import io
import json
import tarfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minitouch_bench import files
from minitouch_bench.episode import Observation
from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.machine import require
from minitouch_bench.policies.policy import IMAGE_SHAPE, TOUCH_SHAPE, PolicySource
from minitouch_bench.protocol.spec import ACTION_SIZES
from minitouch_bench.text import describe

SUFFIX = ".lerobot"
"""Of a checkpoint in one file."""

CONFIG, WEIGHTS = "config.json", "model.safetensors"
BEFORE, AFTER = "policy_preprocessor", "policy_postprocessor"
STATES = "policy_p*processor_*.safetensors"
"""The statistics of normalization, in files that the processors name."""

COPY_OR_CONVERT = (
    "copy the whole directory; one of LeRobot before 0.4 is converted by python -m "
    "lerobot.processor.migrate_policy_normalization --pretrained-path DIR"
)
PARTS = {
    CONFIG: "give the directory pretrained_model of a LeRobot training",
    WEIGHTS: "save the whole policy with save_pretrained; .bin and PEFT weights are not read",
    f"{BEFORE}.json": COPY_OR_CONVERT,
    f"{AFTER}.json": COPY_OR_CONVERT,
}
"""The files that each checkpoint has, and what to do where one is missing."""

PLACES = ("", "pretrained_model", "checkpoints/last/pretrained_model")
"""Where a checkpoint is in what LeRobot's trainings write."""

TYPES = ("act", "diffusion")
PROCESSOR_STEPS = (
    "rename_observations_processor",
    "to_batch_processor",
    "device_processor",
    "normalizer_processor",
    "unnormalizer_processor",
)
"""Processors that need nothing of the Hub: others could download a tokenizer, or import a class."""

IMAGE, STATE = "observation.image", "observation.state"
SEEN = {IMAGE: (3, *IMAGE_SHAPE[1:]), STATE: TOUCH_SHAPE}
"""Shapes of what a policy sees: the gray image on three channels, and touch."""

INSTRUCTIONS = {
    "playing": "Touch the cube as much as possible.",
    "pushing": "Push the cube to the gray target.",
    "opening": "Open the cabinet door by its handle.",
    "pick-up": "Grasp the object and lift it off the table.",
}
"""Each task in words."""


def find_checkpoint(path: Path) -> Path | None:
    """Return the checkpoint that a directory is, or has as a training's last; None without one."""
    places = (path / place for place in PLACES)
    return next(
        (x for x in places if any((x / name).is_file() for name in (CONFIG, WEIGHTS))), None
    )


def name_of(path: Path) -> str:
    """Return what a checkpoint's policy is called: its training, or else its directory."""
    usual = ("pretrained_model", "checkpoints")
    return [x for x in path.resolve().parts if x not in usual and not x.isdigit()][-1]


def pack(folder: Path, *, follow: bool) -> bytes:
    """Return a checkpoint in one file, whose bytes depend on nothing but those of its parts.

    Raises:
        PolicyLoadError: a part is missing.
        OSError: one cannot be read, or is too large.
    """
    for name, remedy in PARTS.items():
        if not (folder / name).is_file():
            raise PolicyLoadError(f"{folder} has no {name}: {remedy}")
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name in sorted({*PARTS, *(path.name for path in folder.glob(STATES))}):
            if len(name.encode()) > tarfile.LENGTH_NAME:
                raise PolicyLoadError(f"{folder} has a file of a name that is too long: {name}")
            content = files.read_file(folder / name, files.LARGEST_CHECKPOINT, follow=follow)
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return packed.getvalue()


class LeRobotPolicy:
    """Run a policy of LeRobot between its processors, as ``lerobot-eval`` does."""

    def __init__(self, policy: Any, before: Any, after: Any) -> None:
        self._policy, self._before, self._after = policy, before, after
        self._prepare = require(
            "lerobot.policies.utils", "lerobot"
        ).prepare_observation_for_inference

    def reset(self, seed: int, task: str) -> None:
        """Forget the rest of a chunk of actions."""
        self._instruction = INSTRUCTIONS[task]
        for part in (self._policy, self._before, self._after):
            part.reset()

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the next action of the chunk, or the first of a new one."""
        seen = {IMAGE: as_lerobot_image(observation["image"]), STATE: observation["touch"].copy()}
        batch = self._before(self._prepare(seen, "cpu", self._instruction))
        (action,) = self._after(self._policy.select_action(batch))
        return action.numpy()


def as_lerobot_image(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image (1, H, W) as LeRobot's policies and datasets have it, (H, W, 3)."""
    return np.repeat(image[0][:, :, np.newaxis], SEEN[IMAGE][0], axis=2)


def load_lerobot(source: PolicySource) -> LeRobotPolicy:
    """Build a policy and its processors on the CPU; nothing is fetched.

    Raises:
        PolicyLoadError: of another type, or trained on another observation or other actions.
        MissingExtraError: LeRobot is not installed.
    """
    with tarfile.open(fileobj=io.BytesIO(source.content), mode="r:") as archive:
        members = {one.name: archive.extractfile(one) for one in archive if one.isfile()}
        parts = {name: member.read() for name, member in members.items() if member}
    config = _read_config(json.loads(parts[CONFIG]))
    converters: Any = require("lerobot.processor.converters", "lerobot")
    before, renamed = _read_processor(
        parts, BEFORE, converters.batch_to_transition, converters.transition_to_batch
    )
    after, _ = _read_processor(
        parts, AFTER, converters.policy_action_to_transition, converters.transition_to_policy_action
    )
    check_features(config, renamed)
    policy = require("lerobot.policies.factory", "lerobot").get_policy_class(config.type)(config)
    policy.load_state_dict(_read_tensors(parts, WEIGHTS))
    return LeRobotPolicy(policy.eval(), before, after)


def _read_config(table: Any) -> Any:
    """Return LeRobot's settings of a policy, which then needs neither the Hub nor a GPU."""
    kind = table.get("type")
    if kind not in TYPES:
        raise PolicyLoadError(
            f"it is of type {kind!r}; read are {' and '.join(TYPES)}, which fetch nothing from the "
            "Hub. Serve another one: docs/how-to/export-a-policy.md, A policy server"
        )
    if table.get("use_peft"):
        raise PolicyLoadError(f"its weights are PEFT's: {PARTS[WEIGHTS]}")
    table |= {"device": "cpu", "pretrained_backbone_weights": None}
    if "compile_model" in table:
        table["compile_model"] = False
    base = require("lerobot.configs.policies", "lerobot").PreTrainedConfig
    try:
        return require("draccus", "lerobot").decode(base, table)
    except Exception as error:  # of draccus, or what the settings' own check raises
        version = require("lerobot", "lerobot").__version__
        text = f"LeRobot {version} does not take its {CONFIG}: {describe(error)}"
        raise PolicyLoadError(text) from error


def _read_processor(
    parts: Mapping[str, bytes], name: str, begin: Any, end: Any
) -> tuple[Any, dict[str, str]]:
    """Return a pipeline of processors between two converters, and how it renames observations."""
    table = json.loads(parts[f"{name}.json"])
    renamed, states = {}, {}
    for step in table["steps"]:
        kind = step.get("registry_name")
        if kind not in PROCESSOR_STEPS:
            text = f"its {name} has a step {kind or step.get('class')!r}"
            raise PolicyLoadError(f"{text}; known: {', '.join(PROCESSOR_STEPS)}")
        if kind == "device_processor":
            step["config"]["device"] = "cpu"
        if kind == "rename_observations_processor":
            renamed = step["config"]["rename_map"]
        if file := step.get("state_file"):
            states[file.removesuffix(".safetensors")] = _read_tensors(parts, file)
    build = require("lerobot.processor", "lerobot").PolicyProcessorPipeline.from_config
    return build(table, state_dict=states, to_transition=begin, to_output=end), renamed


def _read_tensors(parts: Mapping[str, bytes], file: str) -> dict[str, Any]:
    if file not in parts:
        raise PolicyLoadError(f"its {file} is missing: copy the whole directory")
    library = require("safetensors.torch", "lerobot")
    tensors: dict[str, Any] = library.load(parts[file])
    return tensors


def check_features(config: Any, renamed: Mapping[str, str]) -> None:
    """Refuse a policy that was trained on another observation, or with other actions.

    Raises:
        PolicyLoadError: it is one.
    """
    seen = {renamed.get(name, name): shape for name, shape in SEEN.items()}
    for name, feature in config.input_features.items():
        if seen.get(name) != tuple(feature.shape):
            given = ", ".join(f"'{one}' {shape}" for one, shape in seen.items())
            text = f"it was trained on '{name}' {tuple(feature.shape)}; here is {given}"
            raise PolicyLoadError(f"{text}. Train on what minitouch-bench record wrote")
    action = config.action_feature
    if action is None or tuple(action.shape) not in [(size,) for size in ACTION_SIZES]:
        shape = action and tuple(action.shape)
        raise PolicyLoadError(f"its action has the shape {shape}; here it is 4 or 5 numbers")
