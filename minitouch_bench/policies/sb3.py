"""Stable-Baselines3 models, read without running what is pickled in them.

A model's zip holds settings as JSON, in which whatever JSON cannot say is a pickle with a
readable text beside it, and ``policy.pth`` with the weights. Settings and weights rebuild
stable_baselines3's own policy class; the pickles are left alone, except for trusted files.
"""

import io
import json
import re
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray

from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.optional import look_up, require
from minitouch_bench.policies.policy import (
    IMAGE_SHAPE,
    TOUCH_SHAPE,
    Checkpoint,
    Observation,
)
from minitouch_bench.policies.sources import check_zip
from minitouch_bench.tasks.action import ACTION_SIZES

MAX_SETTINGS_BYTES = 16 * 2**20
MAX_WEIGHTS_BYTES = 512 * 2**20
MAX_WIDTH = 4096
MAX_LAYERS = 16

POLICY_CLASSES = {
    "stable_baselines3.sac.policies": "stable_baselines3.sac.policies:MultiInputPolicy",
    "stable_baselines3.td3.policies": "stable_baselines3.td3.policies:MultiInputPolicy",
    "stable_baselines3.common.policies": (
        "stable_baselines3.common.policies:MultiInputActorCriticPolicy"
    ),
}
"""Policy class by the module that a model names: SAC; TD3 and DDPG; PPO and A2C."""

ALGORITHM_BY_SETTING = {
    "PPO": "n_epochs",
    "A2C": "gae_lambda",
    "SAC": "target_entropy",
    "TD3": "policy_delay",
}
"""A setting that only this algorithm has, or only those above it too; DDPG is a TD3 here."""

PLAIN_SETTINGS = {
    "net_arch", "use_sde", "log_std_init", "full_std", "use_expln", "clip_mean", "squash_output",
    "features_extractor_kwargs", "share_features_extractor", "normalize_images", "n_critics",
}  # fmt: skip
"""Settings that change the policy and can be said in JSON."""

TRAINING_SETTINGS = {"optimizer_class", "optimizer_kwargs", "ortho_init"}
"""Settings that change nothing once the weights are there."""

ACTIVATION = re.compile(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>")
EXTRACTOR = "<class 'stable_baselines3.common.torch_layers.CombinedExtractor'>"
OBSERVATION_TEXT = re.compile(
    rf"'image': Box\(0, 255, {re.escape(str(IMAGE_SHAPE))}, uint8\)"
    rf".*'touch': Box\([^()]*, {re.escape(str(TOUCH_SHAPE))}, float32\)"
)


OPENINGS = slice(3, 5)
"""The finger openings in the touch vector, from 0 to 1."""


class NoOptimizer:
    """Stand where a policy wants its optimizer: the first real one takes 1.5 s to import."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass


class Sb3Policy:
    """Run a policy of stable_baselines3."""

    def __init__(self, policy: Any, deterministic: bool) -> None:
        self._policy = policy
        self._deterministic = deterministic

    def reset(self, seed: int, task: str) -> None:
        """Seed torch's generator, which the policy samples from."""
        torch.manual_seed(seed)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the action as ``model.predict`` gives it, rescaled and clipped as it does."""
        with torch.inference_mode():
            action, _ = self._policy.predict(dict(observation), deterministic=self._deterministic)
        return action  # type: ignore[no-any-return]


def load_sb3(checkpoint: Checkpoint) -> Sb3Policy:
    """Rebuild the policy of a model's zip.

    Raises:
        PolicyLoadError: no such zip, another algorithm, observation or network than known here.
        MissingExtraError: stable_baselines3 is not installed.
    """
    require("stable_baselines3", "sb3")
    check_zip(checkpoint.content, checkpoint.target)
    try:
        with zipfile.ZipFile(io.BytesIO(checkpoint.content)) as archive:
            settings = json.loads(_read_member(archive, "data", MAX_SETTINGS_BYTES))
            weights = _read_member(archive, "policy.pth", MAX_WEIGHTS_BYTES)
    except (zipfile.BadZipFile, KeyError, ValueError, RecursionError) as error:
        raise PolicyLoadError(
            f"{checkpoint.target} is no Stable-Baselines3 model: {error}"
        ) from error
    try:
        _check_observation(settings)
        observation_space, action_space = _spaces(settings)
        _refuse_normalized(settings)
    except PolicyLoadError as error:
        raise PolicyLoadError(f"{checkpoint.target}: {error}") from error
    try:
        policy = _rebuild(settings, _read_weights(weights), observation_space, action_space)
    except PolicyLoadError as error:
        if checkpoint.trust:
            return _load_trusted(checkpoint, settings)
        raise PolicyLoadError(f"{checkpoint.target}: {error}") from error
    return Sb3Policy(policy, checkpoint.deterministic)


def _read_member(archive: zipfile.ZipFile, name: str, limit: int) -> bytes:
    """Return a member whose declared size is within the limit; zipfile reads no more than that."""
    declared = archive.getinfo(name).file_size
    if declared > limit:
        raise ValueError(f"'{name}' unpacks to {declared} bytes; the limit is {limit}")
    return archive.read(name)


def _read_weights(content: bytes) -> dict[str, Any]:
    """Return the state dict, after a look at what torch's own inner zip unpacks to."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as inner:
            if sum(member.file_size for member in inner.infolist()) > MAX_WEIGHTS_BYTES:
                raise PolicyLoadError("policy.pth unpacks to more than 512 MiB")
        weights = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except PolicyLoadError:
        raise
    except Exception as error:  # torch raises half a dozen classes for a damaged file
        raise PolicyLoadError("policy.pth holds no plain weights") from error
    if not isinstance(weights, dict):
        raise PolicyLoadError("policy.pth holds no state dict")
    return weights


def _rebuild(
    settings: Any,
    weights: dict[str, Any],
    observation_space: spaces.Dict,
    action_space: spaces.Box,
) -> Any:
    """Return stable_baselines3's policy with its weights.

    Raises:
        PolicyLoadError: the settings name what only a trusted file may bring.
    """
    described = _section(settings, "policy_class")
    policy_class = POLICY_CLASSES.get(str(described.get("__module__")))
    if policy_class is None or "MultiInput" not in str(described.get("__init__")):
        raise PolicyLoadError(
            "its policy is not the MultiInputPolicy of SAC, TD3, DDPG, PPO or A2C; "
            "a policy class of one's own needs --trust"
        )
    arguments = _policy_arguments(_section(settings, "policy_kwargs"))
    if policy_class.startswith("stable_baselines3.common"):
        arguments.setdefault("use_sde", bool(settings.get("use_sde")))
    if policy_class.startswith("stable_baselines3.td3"):
        arguments.pop("use_sde", None)
    try:
        policy = look_up(policy_class)(
            observation_space, action_space, lambda _: 0.0, optimizer_class=NoOptimizer, **arguments
        )
        policy.load_state_dict(weights, strict=True)
    except (TypeError, ValueError, RuntimeError, AssertionError) as error:
        raise PolicyLoadError(
            "its weights do not fit the network that its settings describe"
        ) from error
    policy.set_training_mode(False)
    return policy


def _section(settings: Any, name: str) -> Mapping[str, Any]:
    section = settings.get(name) if isinstance(settings, dict) else None
    if not isinstance(section, dict):
        raise PolicyLoadError(f"its settings have no '{name}'")
    return section


def _check_observation(settings: Any) -> None:
    text = str(_section(settings, "observation_space").get("spaces", ""))
    if len(re.findall(r"Box\(", text)) != 2 or not OBSERVATION_TEXT.search(text):
        raise PolicyLoadError(
            f"it was trained on another observation ({text[:120] or 'unnamed'}); here it is "
            f"Dict(image=uint8 {IMAGE_SHAPE}, touch=float32 {TOUCH_SHAPE})"
        )


def _refuse_normalized(settings: Any) -> None:
    """Refuse a model that saw observations through VecNormalize: its zip lacks their statistics.

    The settings tell of the last observation, and of its original. PPO and A2C have an original
    under VecNormalize only. The others always have one, but there the last finger openings are
    out of their range: normalized numbers are as often negative as positive.
    """
    last, original = (
        settings[name] if isinstance(settings.get(name), dict) else {}
        for name in ("_last_obs", "_last_original_obs")
    )
    text = str(last.get("touch", ""))
    if "..." in text:  # of more than 90 environments numpy writes the first and the last numbers
        text = ""
    touch = np.array(re.findall(r"[-+\d.]+(?:e[-+]?\d+)?", text), np.float64)
    openings = touch.reshape(-1, 11)[:, OPENINGS] if touch.size % 11 == 0 else touch
    is_on_policy = ALGORITHM_BY_SETTING["A2C"] in settings
    if (is_on_policy and original) or (openings < 0).any() or (openings > 1).any():
        raise PolicyLoadError(
            "it was trained under VecNormalize, whose statistics are not in the zip. Train with "
            "VecNormalize(norm_obs=False), or put the normalization into the network"
        )


def _spaces(settings: Any) -> tuple[spaces.Dict, spaces.Box]:
    shape = _section(settings, "action_space").get("_shape")
    if shape not in [[size] for size in ACTION_SIZES]:
        raise PolicyLoadError(f"its actions have shape {shape}, not [4] or [5]")
    observation = spaces.Dict(
        {
            "image": spaces.Box(0, 255, IMAGE_SHAPE, np.uint8),
            "touch": spaces.Box(-np.inf, np.inf, TOUCH_SHAPE, np.float32),
        }
    )
    return observation, spaces.Box(-1.0, 1.0, tuple(shape), np.float32)


def _policy_arguments(section: Mapping[str, Any]) -> dict[str, Any]:
    """Return the policy's arguments from JSON values and the texts beside pickles."""
    arguments: dict[str, Any] = {}
    for name, value in section.items():
        if name.startswith(":") or name in TRAINING_SETTINGS:
            continue
        if name == "activation_fn":
            arguments[name] = _activation(value)
        elif name in PLAIN_SETTINGS and _is_modest(value):
            arguments[name] = value
        elif (name, value) != ("features_extractor_class", EXTRACTOR):
            raise PolicyLoadError(f"its setting '{name}' is not a plain one: it needs --trust")
    return arguments


def _activation(text: Any) -> type[torch.nn.Module]:
    match = ACTIVATION.fullmatch(str(text))
    found = getattr(torch.nn, match[1], None) if match else None
    if not isinstance(found, type):
        raise PolicyLoadError(f"its activation {str(text)[:80]} is unknown here: it needs --trust")
    return found


def _is_modest(value: Any, depth: int = 0) -> bool:
    """Tell whether a setting describes no network too large to be built."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return (
            len(value) <= MAX_LAYERS and depth < 3 and all(_is_modest(v, depth + 1) for v in value)
        )
    return (
        value is None
        or isinstance(value, bool)
        or (isinstance(value, int | float) and abs(value) <= MAX_WIDTH)
    )


def _load_trusted(checkpoint: Checkpoint, settings: Any) -> Sb3Policy:
    """Let stable_baselines3 load a trusted model, running what is pickled in it."""
    names = [name for name, setting in ALGORITHM_BY_SETTING.items() if setting in settings]
    if not names:
        raise PolicyLoadError(f"{checkpoint.target} is none of {', '.join(ALGORITHM_BY_SETTING)}")
    algorithm = getattr(require("stable_baselines3", "sb3"), names[0])
    model = algorithm.load(io.BytesIO(checkpoint.content), device="cpu")
    return Sb3Policy(model.policy, checkpoint.deterministic)
