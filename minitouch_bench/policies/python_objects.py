"""Policies that are Python objects: made by a named factory, or handed over in memory.

A factory is named as ``package.module:attribute`` and needs trust. An object in memory is copied
by pickle: every episode starts with a new copy, in whatever worker it runs, so that no episode
can depend on another one.
"""

import hashlib
import inspect
import io
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from types import CodeType
from typing import Any

import cloudpickle
import numpy as np
from cloudpickle.cloudpickle import _DYNAMIC_CLASS_TRACKER_BY_CLASS as CLASS_IDS
from numpy.typing import NDArray

from minitouch_bench.episode import IN_MEMORY, Observation
from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.machine import look_up_own
from minitouch_bench.policies.policy import Policy, PolicySource, action_size
from minitouch_bench.text import describe


def make_policy(factory: Callable[..., object], deterministic: bool) -> Policy:
    """Call a factory; its parameter ``deterministic``, if any, says not to sample.

    Raises:
        PolicyLoadError: what it makes is not a policy.
    """
    try:
        asks = "deterministic" in inspect.signature(factory).parameters
    except ValueError:  # some built-in callables have no signature to look at
        asks = False
    made = factory(deterministic=deterministic) if asks else factory()
    return _as_policy(_acting_part(made), deterministic)


def load_factory(source: PolicySource) -> Policy:
    """Import the factory and call it.

    Raises:
        PolicyLoadError: not importable, or what it gives is not a policy.
    """
    return make_policy(look_up_own(source.target), source.deterministic)


class _Digester(cloudpickle.Pickler):  # type: ignore[misc]  # it has no types
    """Writes equal objects as equal bytes in each process.

    Pickle writes a tensor and its storage with an address in memory, and a set in an order that
    each process draws. Here both are written as type, shape and bytes, and a set as the sorted
    digests of its members. Code is written without its file, which of a notebook's cell names the
    process.
    """

    def __init__(self, file: io.BytesIO, around: tuple[object, ...] = ()) -> None:
        super().__init__(file)
        self._around = around  # the sets that this object is a member of

    def persistent_id(self, value: object) -> object:
        """Return what is written in place of tensors, storages, sets; None for any other value."""
        if isinstance(value, set | frozenset):
            is_again = any(value is other for other in self._around)  # a member knows its set
            members = () if is_again else value
            digests = sorted(_digest(member, (*self._around, value)) for member in members)
            return type(value), digests, getattr(value, "__dict__", None)
        return _tensor_content(value)

    def reducer_override(self, value: object) -> Any:
        """Return how cloudpickle writes a value."""
        if isinstance(value, CodeType):
            return self.dispatch_table[CodeType](value.replace(co_filename=""))
        return super().reducer_override(value)


def digest_object(value: object) -> str:
    """Return the SHA-256 of an object's content, the same in each process."""
    return _digest(value, ())


def _digest(value: object, around: tuple[object, ...]) -> str:
    written = io.BytesIO()
    _Digester(written, around).dump(value)
    content = written.getvalue()
    for drawn in list(CLASS_IDS.values()):  # again in each process
        content = content.replace(drawn.encode(), b"")
    return hashlib.sha256(content).hexdigest()


def _tensor_content(value: object) -> object:
    """Return type, shape and bytes of a tensor or a storage; None of anything else."""
    torch = sys.modules.get("torch")
    if torch is None:
        return None
    if isinstance(value, torch.TypedStorage | torch.UntypedStorage):
        tensor = torch.empty(0, dtype=torch.uint8).set_(value.cpu().untyped())
    elif isinstance(value, torch.Tensor) and value.layout is torch.strided:
        if value.is_quantized or value.is_meta:
            return None  # it is pickled as its storage and how to read it, or has no bytes
        plain = value.detach().cpu().resolve_conj().resolve_neg().flatten().contiguous()
        tensor = plain.view(torch.uint8)
    else:  # a sparse one is pickled as tensors that are not
        return None
    shape = tuple(value.shape) if isinstance(value, torch.Tensor) else ()
    kind = str(getattr(value, "dtype", ""))
    return type(value).__name__, kind, shape, tensor.numpy().tobytes()


def keep_in_memory(policy: object) -> PolicySource:
    """Return the source of a policy that is given as an object.

    Raises:
        PolicyLoadError: it is not a policy, or cannot be copied.
    """
    try:
        acting = _acting_part(policy)
        content, digest = cloudpickle.dumps(acting), digest_object(acting)
    except (PolicyLoadError, KeyboardInterrupt):
        raise
    except BaseException as error:  # whatever an object raises when it is pickled
        raise PolicyLoadError(
            f"the policy {type(policy).__name__} cannot be copied for each episode: "
            f"{describe(error)}.\nGive a factory, 'package.module:attribute', with trust=True"
        ) from error
    name = type(policy).__name__
    return PolicySource(IN_MEMORY, name, f"{name} in memory", digest, content=content)


def load_object(source: PolicySource) -> Policy:
    """Return a new copy of the object as a policy."""
    return _as_policy(pickle.loads(source.content), source.deterministic)


def _acting_part(policy: object) -> Any:
    """Return what acts: of a model of Stable-Baselines3 its policy; a module as a copy on the CPU.

    Raises:
        PolicyLoadError: it is neither of them and has no ``act``, or is a class.
    """
    if isinstance(policy, type):
        name = policy.__name__
        raise PolicyLoadError(f"{name} is a class, not a policy: give an object of it, {name}()")
    if _has_act(policy):
        return policy
    module, sb3 = policy, sys.modules.get("stable_baselines3.common.base_class")
    if sb3 is not None and isinstance(policy, sb3.BaseAlgorithm):
        from minitouch_bench.policies.sb3 import refuse_normalized  # noqa: PLC0415  imports torch

        refuse_normalized(vars(policy))
        module = policy.policy
    torch = sys.modules.get("torch")
    if torch is None or not isinstance(module, torch.nn.Module):
        raise PolicyLoadError(
            f"{type(policy).__name__} is not a policy: a policy is a name, a file, an object with "
            "act(observation), a Stable-Baselines3 model, or a torch module on (image, touch)"
        )
    if isinstance(module, torch.jit.ScriptModule):  # which cannot be pickled
        return module
    # Not deepcopy, which refuses what a trained PPO keeps of its last gradient.
    return pickle.loads(cloudpickle.dumps(module)).cpu().eval()


def _as_policy(acting: Any, deterministic: bool) -> Policy:
    if _has_act(acting):
        return acting
    if hasattr(acting, "predict") and hasattr(acting, "observation_space"):
        from minitouch_bench.policies.sb3 import Sb3Policy  # noqa: PLC0415  imports torch

        return Sb3Policy(acting, deterministic)
    from minitouch_bench.policies.torch_programs import ModulePolicy  # noqa: PLC0415

    return ModulePolicy(acting.eval())


def _has_act(policy: object) -> bool:
    return callable(getattr(policy, "act", None))


class RandomPolicy:
    """Draw every number uniformly from [-1, 1), from the episode's seed."""

    def __init__(self, source: PolicySource) -> None:
        pass

    def reset(self, seed: int, task: str) -> None:
        """Start the episode's own stream of numbers."""
        self._generator = np.random.default_rng(seed)
        self._size = action_size(task)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return a uniformly random action."""
        return self._generator.uniform(-1.0, 1.0, self._size).astype(np.float32)


OPEN_LOOP_FILE = Path(__file__).with_name("open_loop.npz")
"""One action sequence per task, float32 (T, A); ``benchmarks.open_loop`` chooses them."""


class OpenLoopPolicy:
    """Play one fixed action sequence per task, then hold still; look at nothing."""

    def __init__(self, source: PolicySource) -> None:
        with np.load(OPEN_LOOP_FILE) as file:
            self._sequences = {task: file[task] for task in file.files}

    def reset(self, seed: int, task: str) -> None:
        """Start the task's sequence; without one it holds still from the start."""
        nothing = np.zeros((0, action_size(task)), np.float32)
        self._actions, self._step = self._sequences.get(task, nothing), 0

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the next action of the sequence, zeros after its end."""
        self._step += 1
        if self._step > len(self._actions):
            return np.zeros(self._actions.shape[1], np.float32)
        return self._actions[self._step - 1]


class ZeroPolicy(OpenLoopPolicy):
    """Never move: play no sequence."""

    def __init__(self, source: PolicySource) -> None:
        self._sequences = {}
