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

from minitouch_bench.episode import Observation
from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.machine import require
from minitouch_bench.policies.policy import (
    IMAGE_SHAPE,
    TOUCH_SHAPE,
    PolicySource,
    zero_observation,
)
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import ACTION_SIZES
from minitouch_bench.text import describe, plain_line

ON_POLICY = "gae_lambda"
"""A setting of PPO and A2C alone."""

MISSING = {
    "sb3_contrib": "pip install sb3-contrib",
    "gym": "it was saved by Stable-Baselines3 1.x: load and save it with version 2, see its guide",
}
"""What to do where a package is missing that a user does not write."""

SETTINGS = {
    "policy_class", "policy_kwargs", "use_sde", "observation_space", "action_space",
    "_last_obs", ON_POLICY,
}  # fmt: skip


class Sb3Policy:
    """Run a policy of stable_baselines3, with the frames of ``VecFrameStack`` if it wants them.

    Raises:
        PolicyLoadError: it was trained on another observation, or with other actions.
    """

    def __init__(self, policy: Any, deterministic: bool) -> None:
        self._policy = policy
        self._deterministic = deterministic
        self._frames = count_frames(policy.observation_space)
        check_action_space(policy.action_space)
        # The forces have the largest bounds. VecFrameStack orders bounds otherwise than frames.
        forces = range(TOUCH_SHAPE[0])[PROTOCOL.observation.forces]
        bounds = np.sort(policy.observation_space["touch"].high)
        self._largest_force = bounds[-self._frames * len(forces)]

    def reset(self, seed: int, task: str) -> None:
        """Forget state and frames, and seed torch's generator, which the policy samples from.

        Raises:
            PolicyLoadError: the model was trained with smaller forces than those of the task.
        """
        limit = PROTOCOL.task(task).force_limit
        if self._largest_force < limit:
            raise PolicyLoadError(
                f"the model was trained with forces of at most {self._largest_force:g}; those of "
                f"{task} are newtons, up to {limit:g}. Train in this task, or leave it out with "
                "--tasks; put a scaling into the network, as a features extractor"
            )
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
        PolicyLoadError: another observation, or a module that is not in an installed package.
        MissingExtraError: stable_baselines3 is not installed.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(source.content)) as archive:
            if "data" not in archive.namelist():
                raise PolicyLoadError("it has no model: write it with model.save()")
            settings, weights = archive.read("data"), archive.read("policy.pth")
        policy = _build(_open_settings(settings), weights)
    except (ImportError, PermissionError) as error:
        package = (getattr(error, "name", None) or "").partition(".")[0]
        own = "call cloudpickle.register_pickle_by_value(MODULE) before model.save()"
        raise PolicyLoadError(
            f"it needs a module that no installed package has ({describe(error)}): "
            + MISSING.get(package, own)
        ) from error
    return Sb3Policy(policy, source.deterministic)


def _open_settings(content: bytes) -> dict[str, Any]:
    library: Any = require("stable_baselines3.common.save_util", "sb3")
    used = {name: value for name, value in json.loads(content).items() if name in SETTINGS}
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
    policy.load_state_dict(state)
    policy.set_training_mode(False)
    return policy


def refuse_normalized(settings: dict[str, Any]) -> None:
    """Refuse a model that saw observations through VecNormalize: it lacks their statistics.

    The settings hold the last observation, and those of a model in memory the normalization. In a
    normalized observation the image is not of bytes, or the finger openings are out of their
    range: normalized numbers are as often negative as positive.
    """
    is_normalized = getattr(settings.get("_vec_normalize_env"), "norm_obs", False)
    last = settings.get("_last_obs")
    if isinstance(last, dict) and last.keys() == {"image", "touch"}:
        openings = last["touch"].reshape(-1, *TOUCH_SHAPE)[:, PROTOCOL.observation.openings]
        are_shares = ((openings >= 0) & (openings <= 1)).all()
        is_normalized |= last["image"].dtype != np.uint8 or not are_shares
    if is_normalized:
        raise PolicyLoadError(
            "it was trained under VecNormalize, whose statistics are not in the model. Train with "
            "VecNormalize(norm_obs=False), or put the normalization into the network"
        )


def check_action_space(space: Any) -> None:
    """Refuse a space of other actions; infinite bounds, as of ``ClipAction``, are no others.

    Raises:
        PolicyLoadError: it is one.
    """
    shapes = [(size,) for size in ACTION_SIZES]
    is_box = isinstance(space, spaces.Box) and space.shape in shapes
    if not is_box or not np.isin((-space.low, space.high), (1, np.inf)).all():
        raise PolicyLoadError(
            f"it was trained with other actions ({str(space)[:120]}); here they are 4 or 5 numbers "
            "from -1 to 1. Train without RescaleAction, or rescale them in a Python factory"
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
    return frames
