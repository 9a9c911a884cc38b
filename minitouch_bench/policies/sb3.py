"""Stable-Baselines3 models: the library opens what is pickled in them, so they run as saved.

A model's zip holds settings as JSON, in which whatever JSON cannot say is a pickle, and
``policy.pth`` with the weights. Only the settings that describe the policy are opened: a model's
``load`` would also make its buffers and optimizers, and need the classes of its training.
"""

import io
import json
import warnings
import zipfile
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray

from minitouch_bench.errors import PolicyLoadError, describe, plain_line
from minitouch_bench.machine import require
from minitouch_bench.policies.policy import (
    IMAGE_SHAPE,
    TOUCH_SHAPE,
    Observation,
    PolicySource,
    zero_observation,
)
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import ACTION_SIZES

ON_POLICY = "gae_lambda"
"""A setting of PPO and A2C alone."""

LEAST_FORCE_LIMIT = min(task.force_limit for task in PROTOCOL.tasks)
"""The smallest bound (N) of the forces in any task's observation space."""

SETTINGS = {
    "policy_class", "policy_kwargs", "use_sde", "observation_space", "action_space",
    "_last_obs", ON_POLICY,
}  # fmt: skip


class Sb3Policy:
    """Run a policy of stable_baselines3, with the frames of ``VecFrameStack`` if it wants them.

    Raises:
        PolicyLoadError: it was trained on another observation.
    """

    def __init__(self, policy: Any, deterministic: bool) -> None:
        self._policy = policy
        self._deterministic = deterministic
        space = getattr(policy, "observation_space", None)
        self._frames = 1 if space is None else count_frames(space)

    def reset(self, seed: int, task: str) -> None:
        """Forget state and frames, and seed torch's generator, which the policy samples from."""
        self._state = None
        self._stack = {
            name: np.zeros((self._frames * len(value), *value.shape[1:]), value.dtype)
            for name, value in zero_observation().items()
        }
        torch.manual_seed(seed)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the action as ``model.predict`` gives it, rescaled and clipped as it does."""
        for name, value in observation.items():  # the newest frame is the last
            self._stack[name] = np.concatenate((self._stack[name][len(value) :], value))
        with torch.inference_mode():
            action, self._state = self._policy.predict(
                dict(self._stack), self._state, deterministic=self._deterministic
            )
        return action


def load_sb3(source: PolicySource) -> Sb3Policy:
    """Build the policy of a model's zip, which runs what is pickled in it.

    Raises:
        PolicyLoadError: no such zip, another observation, or weights of another network.
        PolicyLoadError: it needs a module that is not in an installed package.
        MissingExtraError: stable_baselines3 is not installed.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(source.content)) as archive:
            settings, weights = archive.read("data"), archive.read("policy.pth")
        policy = _build(_open_settings(settings), weights)
    except (zipfile.BadZipFile, LookupError, ValueError, RecursionError) as error:
        raise PolicyLoadError(f"not a Stable-Baselines3 model: {error}") from error
    except (ImportError, PermissionError) as error:
        raise PolicyLoadError(
            f"it needs a module that no installed package has ({describe(error)}): call "
            "cloudpickle.register_pickle_by_value(MODULE) before model.save()"
        ) from error
    return Sb3Policy(policy, source.deterministic)


def _open_settings(content: bytes) -> dict[str, Any]:
    library: Any = require("stable_baselines3.common.save_util", "sb3")
    document = json.loads(content)
    if not isinstance(document, dict):
        raise PolicyLoadError("its settings are not a table")
    used = {name: value for name, value in document.items() if name in SETTINGS}
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "Could not deserialize")
        try:
            settings: dict[str, Any] = library.json_to_data(json.dumps(used))
        except UserWarning as warning:
            reason = plain_line(str(warning).rpartition("Exception: ")[2])
            raise PolicyLoadError(f"what is pickled in it cannot be opened: {reason}") from warning
    return settings


def _build(settings: dict[str, Any], weights: bytes) -> Any:
    observed, acted = settings["observation_space"], settings["action_space"]
    count_frames(observed)
    if getattr(acted, "shape", None) not in [(size,) for size in ACTION_SIZES]:
        raise PolicyLoadError(f"its actions have shape {acted.shape}, not (4,) or (5,)")
    refuse_normalized(settings)
    # A policy makes its optimizer, of which the first real one takes 1.5 s to import.
    no_optimizer = {"optimizer_class": lambda *_, **__: None}
    arguments = {**settings["policy_kwargs"], **no_optimizer}
    if ON_POLICY in settings:
        arguments["use_sde"] = settings["use_sde"]
    policy = settings["policy_class"](observed, acted, lambda _: 0.0, **arguments)
    try:
        state = torch.load(io.BytesIO(weights), map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises half a dozen classes for a damaged file
        raise PolicyLoadError("policy.pth contains no plain weights") from error
    try:
        policy.load_state_dict(state)
    except (RuntimeError, TypeError) as error:
        raise PolicyLoadError("its weights do not fit its network") from error
    policy.set_training_mode(False)
    return policy


def refuse_normalized(settings: dict[str, Any]) -> None:
    """Refuse a model that saw observations through VecNormalize: its zip lacks their statistics.

    The settings hold the last observation. In a normalized one the image is not of bytes, or the
    finger openings are out of their range: normalized numbers are as often negative as positive.
    """
    last = settings.get("_last_obs")
    if not isinstance(last, dict) or last.keys() != {"image", "touch"}:
        return
    openings = last["touch"].reshape(-1, *TOUCH_SHAPE)[:, PROTOCOL.observation.openings]
    if last["image"].dtype != np.uint8 or (openings < 0).any() or (openings > 1).any():
        raise PolicyLoadError(
            "it was trained under VecNormalize, whose statistics are not in the zip. Train with "
            "VecNormalize(norm_obs=False), or put the normalization into the network"
        )


def count_frames(space: Any) -> int:
    """Return how many observations one of the space joins: 1, or n with ``VecFrameStack(n)``.

    Raises:
        PolicyLoadError: it is another space.
    """
    parts = dict(space.spaces) if isinstance(space, spaces.Dict) else {}
    touch = parts.pop("touch", None)
    felt = getattr(touch, "shape", None), getattr(touch, "dtype", None)
    frames = max(1, (felt[0] or (0,))[0] // TOUCH_SHAPE[0])
    images = {"image": spaces.Box(0, 255, (frames * IMAGE_SHAPE[0], *IMAGE_SHAPE[1:]), np.uint8)}
    if parts != images or felt != ((frames * TOUCH_SHAPE[0],), np.float32):
        raise PolicyLoadError(
            f"it was trained on another observation ({str(space)[:120]}); here it is "
            f"Dict(image=uint8 {IMAGE_SHAPE}, touch=float32 {TOUCH_SHAPE}), or n of them joined "
            "by VecFrameStack"
        )
    assert isinstance(touch, spaces.Box)  # which alone has a shape and a type of numbers
    # The forces have the largest bounds. VecFrameStack orders bounds otherwise than frames.
    felt_forces = np.arange(TOUCH_SHAPE[0])[PROTOCOL.observation.forces]
    limit = np.sort(touch.high)[-frames * len(felt_forces)]
    if limit < LEAST_FORCE_LIMIT:
        raise PolicyLoadError(
            f"it was trained with forces of at most {limit:g}; here they are newtons, up to "
            f"{LEAST_FORCE_LIMIT:g} or more. Put the scaling into the network: a features extractor"
        )
    return frames
