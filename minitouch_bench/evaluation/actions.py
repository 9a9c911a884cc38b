"""``actions.npz``: every action of a run, written once, read with care, and played again."""

import io
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.conditions import STANDARD, Conditions
from minitouch_bench.errors import PolicyFaultError, RunDirectoryError, UnreadableFileError
from minitouch_bench.files import ACTIONS_FILE, LARGEST_ACTIONS, os_errors_as, read_file, write_file
from minitouch_bench.policies.policy import Observation
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import EpisodeRecord, EpisodeSpec, Role
from minitouch_bench.tasks.environment import MiniTouchEnv

MAX_NPY_HEADER = 256
"""Bytes before the numbers of an array; numpy writes 128."""

Actions = NDArray[np.float32]

ENTRY_MARK = b"PK\x01\x02"
"""What each entry of a ZIP file's list begins with."""

CHANCE_MARKS = 100
"""How often packed data may hold the same four bytes by chance."""

END_OF_RECORDING = "the recorded actions end before the episode does"
"""The fault of a replayed episode that its policy broke off."""


def read_actions(directory: Path, specs: Sequence[EpisodeSpec]) -> dict[str, Actions]:
    """Read back the actions that ``actions.npz`` has of these episodes, float32 (T, A) each.

    Every declared size is looked at before anything is unpacked.

    Raises:
        RunDirectoryError: the file is missing or damaged, it holds other episodes too, or
            what it holds are no actions of their task.
    """
    path = directory / ACTIONS_FILE
    tasks = {spec.key: spec.task for spec in specs}
    with os_errors_as(UnreadableFileError, path, "read"):
        content = read_file(path, LARGEST_ACTIONS)
    # Half a kilobyte of memory for each entry, before the first can be looked at.
    if content.count(ENTRY_MARK) > len(specs) + CHANCE_MARKS:
        raise RunDirectoryError(f"{path} is damaged: it lists more than {len(specs)} episodes")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            actions: dict[str, Actions] = {}
            for member in archive.infolist():
                key = member.filename.removesuffix(".npy")
                if key not in tasks or key in actions:
                    raise RunDirectoryError(
                        f"{path} holds {key[:80]!a}, which is no episode of the run"
                    )
                actions[key] = _read_array(archive, member, tasks[key])
            return actions
    except RunDirectoryError:
        raise
    except Exception as error:  # zipfile, its decompressors and numpy's parser have no common root
        raise RunDirectoryError(f"{path} is damaged: {error}") from error


def _read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo, task: str) -> Actions:
    """Unpack one episode's actions.

    Raises:
        ValueError: it is something else.
    """
    spec = PROTOCOL.task(task)
    size = spec.action_size
    longest = spec.max_steps * size * np.dtype(np.float32).itemsize
    if member.file_size > longest + MAX_NPY_HEADER:
        raise ValueError(f"{member.filename} declares {member.file_size} bytes")
    with archive.open(member) as file:
        if np.lib.format.read_magic(file) != (1, 0):
            raise ValueError(f"{member.filename} is an array of another version")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
        content = file.read()
    if dtype != np.float32 or fortran or len(shape) != 2 or shape[1] != size:
        raise ValueError(f"{member.filename} is {dtype} {shape}, not float32 (steps, {size})")
    if not 0 <= shape[0] <= spec.max_steps or len(content) != shape[0] * size * 4:
        raise ValueError(f"{member.filename} does not hold 0 to {spec.max_steps} actions")
    actions = np.frombuffer(content, np.float32).reshape(shape).copy()
    if not (np.abs(actions) <= 1).all():
        raise ValueError(f"{member.filename} holds actions beyond -1 to 1")
    return actions


def write_actions(records: Sequence[EpisodeRecord], directory: Path) -> None:
    """Write ``actions.npz``: per episode, by its key, float32 (T, A) as applied.

    Raises:
        RunDirectoryError: the file cannot be written.
    """
    content = io.BytesIO()
    arrays: dict[str, Any] = {record.spec.key: record.trace.actions for record in records}
    np.savez_compressed(content, **arrays)
    write_file(directory / ACTIONS_FILE, content.getvalue())


@dataclass(frozen=True)
class Recording:
    """The actions of a run by the keys of its episodes, float32 (T, A) each, as applied."""

    actions: Mapping[str, NDArray[np.float32]]
    conditions: Conditions = STANDARD

    def make_actor(self, role: Role) -> "RecordedActor":
        """Return an actor that repeats them."""
        return RecordedActor(self.actions)


class RecordedActor:
    """Repeats the actions of each episode, and fails where they end too early."""

    _rest: Iterator[NDArray[np.float32]]

    def __init__(self, actions: Mapping[str, NDArray[np.float32]]) -> None:
        self._actions = actions

    def reset(self, environment: MiniTouchEnv, spec: EpisodeSpec) -> None:
        """Find the episode's actions."""
        self._rest = iter(self._actions[spec.key])

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the next action.

        Raises:
            PolicyFaultError: there is none.
        """
        try:
            return next(self._rest)
        except StopIteration:
            raise PolicyFaultError(END_OF_RECORDING) from None

    def close(self) -> None:
        """Do nothing: there is nothing to free."""
