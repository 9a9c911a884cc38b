"""A run that is not finished: its header, and the episodes that are done, each in its own file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.conditions import Conditions
from minitouch_bench.documents import read_json, write_json
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import UNFINISHED, clear_folder, make_folder, os_errors_as
from minitouch_bench.metrics.summary import measure
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import (
    EpisodeRecord,
    EpisodeSpec,
    EpisodeTrace,
    Outcome,
    PolicyIdentity,
)
from minitouch_bench.runs.actions import check_actions, pack_arrays, unpack_arrays
from minitouch_bench.runs.run import RunHeader
from minitouch_bench.units import Units, unit_name

HEADER = "header"
DTYPES = {
    "actions": "<f4", "clipped": "|b1", "rewards": "<f4", "ticks": "<i2", "contact_ticks": "<i2",
    "onsets": "<i2", "touch": "<f4", "object_state": "<f8",
}  # fmt: skip
"""The arrays of a trace."""


@dataclass(frozen=True)
class StoredHeader:
    """What the episodes that are done were played with."""

    header: RunHeader
    packages: Mapping[str, str]


@dataclass(frozen=True)
class _StoredEpisode:
    """What a file holds of an episode before its arrays."""

    spec: EpisodeSpec
    outcome: Outcome
    fault: str
    first_touch_tick: int


class UnfinishedRun:
    """What is kept of a run until it is finished, in a folder of its locked directory."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._folder = directory / UNFINISHED
        self._units = Units(self._folder, ".unit")

    def begin(self, header: RunHeader, packages: Mapping[str, str]) -> None:
        """Keep the header.

        Raises:
            RunDirectoryError: the folder cannot be made.
            InfrastructureError: the disk is full.
        """
        make_folder(self._folder)
        self._units.keep(HEADER, write_json(StoredHeader(header, packages)))

    def check(self, header: RunHeader, packages: Mapping[str, str]) -> None:
        """Refuse to go on with another run, or with other packages.

        Raises:
            RunDirectoryError: the text names the differences.
        """
        make_folder(self._folder)
        content = self._units.read(HEADER)
        if content is None and not any(self._folder.glob("*.unit")):
            self.begin(header, packages)  # it was killed before its first file
            return
        if content is None:
            raise RunDirectoryError(
                f"{self._units.path(HEADER)} is missing or damaged: start again with --fresh"
            )
        stored = read_json(content, StoredHeader, str(self._units.path(HEADER)))
        check_same(header, stored.header, self._directory)
        if stored.packages != packages:
            names = sorted({name for name, _ in {*stored.packages.items()} ^ {*packages.items()}})
            differences = [
                f"{name} {stored.packages.get(name, 'none')} there, "
                f"{packages.get(name, 'none')} here"
                for name in names
            ]
            raise RunDirectoryError(
                f"{self._directory} was begun with other packages: {'; '.join(differences)}.\n"
                "Install those, or start again with --fresh"
            )

    def keep(self, record: EpisodeRecord) -> None:
        """Keep one episode; it survives whatever happens after this returns.

        Raises:
            InfrastructureError: the disk is full or fails; what is kept stays.
        """
        self._units.keep(unit_name(record.spec.key), _pack(record))

    def records(self, specs: Sequence[EpisodeSpec]) -> tuple[EpisodeRecord, ...]:
        """Return those of the episodes that are done; a damaged one is done again."""
        kept = ((spec, self._units.read(unit_name(spec.key))) for spec in specs)
        records = (_unpack(spec, content) for spec, content in kept if content is not None)
        return tuple(record for record in records if record is not None)

    def remove(self) -> None:
        """Remove all of it: the run is finished.

        Raises:
            RunDirectoryError: it cannot be removed.
        """
        with os_errors_as(RunDirectoryError, self._folder, "removed"):
            clear_folder(self._directory, UNFINISHED)


def _pack(record: EpisodeRecord) -> bytes:
    trace = record.trace
    head = _StoredEpisode(record.spec, record.outcome, record.fault, trace.first_touch_tick)
    arrays = {name: np.asarray(getattr(trace, name), dtype) for name, dtype in DTYPES.items()}
    return write_json(head).replace(b"\n", b"") + b"\n" + pack_arrays(arrays)


def _unpack(spec: EpisodeSpec, content: bytes) -> EpisodeRecord | None:
    """Return an episode, None where the content is not one of this spec."""
    text, _, packed = content.partition(b"\n")
    try:
        stored = read_json(text, _StoredEpisode, spec.key)
        arrays = dict(unpack_arrays(packed, len(DTYPES)))
        if stored.spec != spec or not _are_of(spec.task, arrays):
            return None
        check_actions(spec.key, arrays["actions"], spec.task)
        trace = EpisodeTrace(**arrays, first_touch_tick=stored.first_touch_tick)
        record = EpisodeRecord(spec, stored.outcome, trace, stored.fault)
        with np.errstate(over="raise", invalid="raise"):
            write_json(measure(record))  # NaN, infinity and negative counts cannot be written
    except Exception:  # whatever a damaged file makes zipfile and numpy's parser raise
        return None
    return record


def _are_of(task: str, arrays: Mapping[str, NDArray[Any]]) -> bool:
    """Tell whether arrays have the kinds and the shapes of a trace of the task."""
    if arrays.keys() != DTYPES.keys():
        return False
    steps, action_size = len(arrays["actions"]), PROTOCOL.task(task).action_size
    widths = {
        "actions": (steps, action_size),
        "touch": (steps + 1, PROTOCOL.observation.touch_size),
        "object_state": (steps + 1, arrays["object_state"].shape[-1]),
    }
    return all(
        array.dtype == DTYPES[name] and array.shape == widths.get(name, (steps,))
        for name, array in arrays.items()
    )


def check_same(asked: RunHeader, there: RunHeader, directory: Path) -> None:
    """Refuse to go on with a run of other settings.

    Raises:
        RunDirectoryError: the text names the differences.
    """
    settings = _flat(asked)
    differences = [
        f"{name}: {_in_words(value)} there, {_in_words(settings[name])} asked for"
        for name, value in _flat(there).items()
        if value != settings[name]
    ]
    if differences:
        raise RunDirectoryError(
            f"{directory} holds another run and cannot be resumed.\n" + "; ".join(differences)
        )


def _flat(header: RunHeader) -> dict[str, object]:
    values: dict[str, object] = {}
    for record in (header, header.plan, header.plan.limits):
        values |= {field.name: getattr(record, field.name) for field in fields(record)}
    for name in ("policy", "exploration"):
        policy = getattr(header, name)
        if policy is not None and policy.digest:  # the same bytes, wherever they are now
            values[name] = replace(policy, source="")
    return {name: value for name, value in values.items() if name not in ("plan", "limits")}


def _in_words(value: object) -> str:
    if isinstance(value, PolicyIdentity):
        return f"{value.name} {value.digest[:12]}".rstrip()
    if isinstance(value, Conditions):
        return ", ".join(value.in_words()) or "none"
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or "none"
    return "none" if value is None else str(value)
