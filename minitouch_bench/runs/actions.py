"""``actions.npz``, beside ``run.json``: every action as applied. Arrays are read with care."""

import io
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import EpisodeSpec, PlayedEpisode
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import ACTIONS_FILE, ENTRY_MARK, KIB, damage_as, write_file
from minitouch_bench.protocol.minitouch import PROTOCOL

MAX_NPY_HEADER = 256
"""Bytes before the numbers of an array; numpy writes 128."""
MAX_ARRAY = 256 * KIB
"""Bytes of an episode's largest array: 200 steps take 10."""

Actions = NDArray[np.float32]

CHANCE_MARKS = 100
"""How often packed data may hold the same four bytes by chance."""


def pack_arrays(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the bytes of an ``.npz`` file."""
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]  # allow_pickle is not a name
    return content.getvalue()


def unpack_arrays(content: bytes, most: int) -> Iterator[tuple[str, NDArray[Any]]]:
    """Unpack the arrays of an ``.npz`` file, at most ``most``; a declared size is looked at first.

    Raises:
        Exception: it is damaged, of any kind that zipfile, zlib and numpy's parser raise.
    """
    # Half a kilobyte of memory for each entry, before the first can be looked at.
    if content.count(ENTRY_MARK) > most + CHANCE_MARKS:
        raise ValueError(f"it lists more than {most} arrays")
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        for member in archive.infolist():
            yield member.filename.removesuffix(".npy"), _read_array(archive, member)


def _read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    if member.file_size > MAX_ARRAY + MAX_NPY_HEADER:
        raise ValueError(f"{member.filename} declares {member.file_size} bytes")
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        # zipfile unpacks a member of bzip2 or LZMA as a whole, however little is asked of it.
        raise ValueError(f"{member.filename} is packed in a way that numpy does not use")
    with archive.open(member) as file:
        if np.lib.format.read_magic(file) != (1, 0):
            raise ValueError(f"{member.filename} is an array of another version")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
        content = file.read(member.file_size)  # without a size zlib unpacks up to 2 GiB of it
    if dtype.hasobject or fortran or min(shape, default=0) < 0:
        raise ValueError(f"{member.filename} is an array of another kind")
    return np.frombuffer(content, dtype).reshape(shape).copy()


def parse_actions(content: bytes, specs: Sequence[EpisodeSpec], name: str) -> dict[str, Actions]:
    """Return the actions that ``actions.npz`` has of these episodes, float32 (T, A) each.

    Raises:
        RunDirectoryError: the file ``name`` is damaged, it holds other episodes too, or
            what it holds are not actions of their task.
    """
    tasks = {spec.key: spec.task for spec in specs}
    actions: dict[str, Actions] = {}
    with damage_as(RunDirectoryError, f"{name} is damaged"):
        for key, array in unpack_arrays(content, len(specs)):
            if key not in tasks or key in actions:
                what = f"{name} holds {key[:80]!a}, which is not an episode of the run"
                raise RunDirectoryError(what)
            _check_actions(key, array, tasks[key])
            actions[key] = array
    return actions


def _check_actions(key: str, actions: NDArray[Any], task: str) -> None:
    """Refuse what are not an episode's actions.

    Raises:
        ValueError: they are something else.
    """
    spec = PROTOCOL.task(task)
    shape = actions.shape
    if actions.dtype != np.float32 or len(shape) != 2 or shape[1] != spec.action_size:
        raise ValueError(f"{key} is {actions.dtype} {shape}, not float32 (T, {spec.action_size})")
    if shape[0] > spec.max_steps:
        raise ValueError(f"{key} does not hold 0 to {spec.max_steps} actions")
    if not (np.abs(actions) <= 1).all():
        raise ValueError(f"{key} holds actions beyond -1 to 1")


def write_actions(records: Sequence[PlayedEpisode], directory: Path) -> None:
    """Write ``actions.npz``: per episode, by its key, float32 (T, A) as applied.

    Raises:
        RunDirectoryError: the file cannot be written.
    """
    arrays = {record.spec.key: record.trace.actions for record in records}
    write_file(directory / ACTIONS_FILE, pack_arrays(arrays))
