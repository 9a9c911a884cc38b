"""Write a torch module as a file, once both act alike in an episode."""

import hashlib
import io
import pickle
import warnings
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from minitouch_bench.episode import Observation
from minitouch_bench.errors import PolicyLoadError, UsageError
from minitouch_bench.evaluation.policy_setup import kept_generators
from minitouch_bench.evaluation.rollout import run_episode
from minitouch_bench.files import write_file
from minitouch_bench.policies.forkserver import seed_everything
from minitouch_bench.policies.native import to_tensors
from minitouch_bench.policies.policy import (
    Isolation,
    IsolationOptions,
    Policy,
    PolicySource,
    action_size,
    zero_observation,
)
from minitouch_bench.policies.policy_process import isolate
from minitouch_bench.policies.python_objects import digest_object, keep_in_memory
from minitouch_bench.policies.torch_programs import ModulePolicy
from minitouch_bench.protocol.spec import fit_action
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.text import describe

EXPORTED = ".pt2"

SAME_ACTION = 1e-5
"""Largest difference between numbers of an applied action, from -1 to 1, that are the same."""

LOST = (
    "The export has lost {}: keep a state in a buffer that forward writes in place, as in "
    "self.state[:] = new"
)
NOTHING_LOST = "The export keeps one path through forward, and no state outside the module"


@dataclass(frozen=True)
class Export:
    """A policy's file, and the episode in which it acted as the module does.

    ``difference``: the largest one of two numbers of an action; 0 where all bits are the same.
    """

    path: Path
    task: str
    actions: int
    difference: float

    def __str__(self) -> str:
        how = f"differ by at most {self.difference:.1g}" if self.difference else "are the same bits"
        return f"{self.path}: all {self.actions} actions of an episode of {self.task} {how}"


class _SideBySide:
    """Acts as the module does, and asks the file for its action at the same observation."""

    def __init__(self, module: Policy, file: Policy) -> None:
        self._module, self._file = module, file
        self.differences: list[float] = []
        self._size = 0

    def reset(self, seed: int, task: str) -> None:
        """Begin the episode of both."""
        self._size = action_size(task)
        self._file.reset(seed, task)
        seed_everything(seed)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the module's action."""
        action = fit_action(self._module.act(observation), self._size)
        applied = [one.clip(-1.0, 1.0) for one in (action, self._file.act(observation))]
        self.differences.append(float(np.abs(applied[0] - applied[1]).max()))
        return action


def export_module(module: object, path: Path, task: str) -> Export:
    """Export a module by ``torch.export`` as it evaluates, on the CPU, and write the file.

    The module is left as it is. The file is written only if it acts like the module.

    Raises:
        UsageError: no such task, not a torch module, or a file name of another format.
        PolicyLoadError: the module cannot be exported or fails in the episode, or the file acts
            differently; the text names the state that the export has lost.
    """
    if not isinstance(module, nn.Module) or isinstance(module, torch.jit.ScriptModule):
        kind = type(module).__name__
        raise UsageError(f"{kind} is not a torch module that can be exported: give the nn.Module")
    if path.suffix != EXPORTED:
        raise UsageError(f"{path} is not a name of what is written, a {EXPORTED} file")
    (spec,) = make_plan("smoke", (task,), episodes=1).specs()
    try:
        pickled = keep_in_memory(module).content
    except PolicyLoadError as error:
        reason = str(error).partition("\n")[0]  # its advice is for an evaluation
        raise PolicyLoadError(f"{path} is not written: {reason}") from error
    content = _exported(_copy(pickled))
    digest = hashlib.sha256(content).hexdigest()
    file = PolicySource("torch.export", path.stem, str(path), digest, content=content)
    copied = _copy(pickled)
    before = _state(copied)
    with (
        kept_generators(),
        closing(isolate(file, IsolationOptions(Isolation.PROCESS, trust=True))) as isolated,
        closing(MiniTouchEnv(task)) as environment,
    ):
        torch.set_num_threads(1)  # as in an evaluation
        both = _SideBySide(ModulePolicy(copied), isolated)
        played = run_episode(environment, both, spec)
    if played.fault:
        raise PolicyLoadError(f"{path} is not written, the episode failed: {played.fault}")
    differences = both.differences
    if not max(differences) <= SAME_ACTION:
        first = next(i for i, value in enumerate(differences, 1) if not value <= SAME_ACTION)
        text = (
            f"{path} is not written: from action {first} of {len(differences)} on it acts "
            f"differently from the module, by up to {max(differences):.2g}.\n"
        )
        lost = [name for name, value in _state(copied).items() if value != before.get(name)]
        raise PolicyLoadError(text + (LOST.format(", ".join(lost)) if lost else NOTHING_LOST))
    write_file(path, content)
    return Export(path, task, len(differences), max(differences))


def _copy(pickled: bytes) -> nn.Module:
    copied: nn.Module = pickle.loads(pickled)
    return copied.cpu().eval()


def _exported(module: nn.Module) -> bytes:
    """Return the file of a module; the export changes the module's state."""
    written = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a state that is lost: the episode shows it
        try:
            program = torch.export.export(module, to_tensors(zero_observation()))
            torch.export.save(program, written)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # whatever forward raises, SystemExit too
            raise PolicyLoadError(
                f"torch.export cannot export {type(module).__name__}: {describe(error)}.\n"
                "Its forward takes an image, uint8 (1, 1, 84, 84), and touch, float32 (1, 11)"
            ) from error
    return written.getvalue()


def _state(module: nn.Module) -> dict[str, str]:
    """Return digests of what a module can remember with, by "name (type)".

    An assigned buffer is kept in the module itself only, and is lost in a part of it (torch 2.13).
    """
    own = vars(nn.Module()).keys()
    return {
        f"{f'{place}.{name}'.lstrip('.')} ({type(value).__name__})": digest_object(value)
        for place, part in module.named_modules()
        if not type(part).__module__.startswith("torch.nn.")
        for name, value in (vars(part) | dict(part.named_buffers(recurse=False))).items()
        if name not in own
    }
