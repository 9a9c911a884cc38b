"""Generate a set, resumable after kill -9, always the same bytes; and how any set is written."""

import json
import platform
import shutil
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from minitouch_bench.errors import InfrastructureError, RunDirectoryError
from minitouch_bench.files import lock_directory, os_errors_as, replace_file
from minitouch_bench.machine import installed_versions
from minitouch_bench.processes import run_in_workers
from minitouch_bench.protocol.spec import content_digest
from minitouch_bench.shapegen.body_codec import digest
from minitouch_bench.shapegen.build import BUILD, make_shape
from minitouch_bench.shapegen.families import GENERATOR_VERSION
from minitouch_bench.shapegen.manifest import (
    MANIFEST,
    PACK,
    SCHEMA,
    canonical_shape_set,
    splits_of,
)
from minitouch_bench.simulation.bullet import BUILDS

PARTIAL, PLAN = ".partial", "plan.json"
HINT = "; the shapes made so far are kept: make room and run the same command again"
Progress = Callable[[int, int], None]
"""Called with (done, total)."""

LIBRARIES = ("numpy", "coacd", "manifold3d", "fast-simplification")


@dataclass(frozen=True)
class GenerateResult:
    """What a generation gave: the set's folder and digest, and draws refused by reason."""

    folder: Path
    digest: str
    count: int
    refused: dict[str, int]


def generate(
    folder: Path, count: int, root: int, workers: int, progress: Progress = lambda *_: None
) -> GenerateResult:
    """Make shapes 0 to ``count`` - 1 of seed ``root``, using those kept, and write them as a set.

    Raises:
        RunDirectoryError: another generator works in the folder, or it holds something else.
        InfrastructureError: the disk is full, or a worker failed.
    """
    header = {
        "name": f"minitouch-{count}" + (f"-seed-{root}" if root else ""),
        "generator": GENERATOR_VERSION,
        "seed": root,
        "parameters": asdict(BUILD),
    }
    with lock_directory(folder):
        parts = open_parts(folder, {**header, "versions": versions(), "count": count})
        missing = [index for index in range(count) if kept_shape(parts, index) is None]
        progress(count - len(missing), count)
        tasks = [(root, index) for index in missing]
        for done, (position, (entry, record)) in enumerate(
            run_in_workers(make_shape, tasks, workers, name=lambda task: f"shape {task[1]}"),
            start=1,
        ):
            keep_shape(parts, missing[position], entry, record)
            progress(count - len(missing) + done, count)
        shapes = (kept_shape(parts, index) for index in range(count))
        made = [shape for shape in shapes if shape is not None]
        document = write_set(folder, header, made)
        shutil.rmtree(parts)
    refused = sum((Counter(entry["refused"]) for entry, _ in made), Counter[str]())
    return GenerateResult(folder, content_digest(document), count, refused)


def open_parts(folder: Path, plan: dict[str, Any]) -> Path:
    """Return the folder of single shapes, begun with this plan or new.

    Raises:
        RunDirectoryError: a finished set, or shapes of another plan, are there already.
        InfrastructureError: it cannot be written.
    """
    parts, text = folder / PARTIAL, json.dumps(plan, sort_keys=True).encode()
    if (parts / PLAN).exists():
        if (parts / PLAN).read_bytes() == text:
            return parts
        raise RunDirectoryError(
            f"{folder} contains a generation begun with other settings; "
            f"delete {parts} or choose another --output"
        )
    if (folder / MANIFEST).exists():
        raise RunDirectoryError(f"{folder} contains a finished set; choose another --output")
    with os_errors_as(InfrastructureError, parts, "written"):
        parts.mkdir(exist_ok=True)
        replace_file(parts / PLAN, text)
    return parts


def keep_shape(parts: Path, index: int, entry: Mapping[str, Any], record: bytes) -> None:
    """Keep one shape, in a file that is whole or missing.

    Raises:
        InfrastructureError: the disk is full; what was made before stays.
    """
    file = parts / f"{index}.shape"
    with os_errors_as(InfrastructureError, file, "written", HINT):
        replace_file(file, json.dumps(entry, allow_nan=False).encode() + b"\n" + record)


def kept_shape(parts: Path, index: int) -> tuple[dict[str, Any], bytes] | None:
    """Return a kept shape, or None if it is missing."""
    file = parts / f"{index}.shape"
    if not file.exists():
        return None
    text, _, record = file.read_bytes().partition(b"\n")
    return json.loads(text), record


def versions() -> dict[str, str]:
    """Return the versions of everything a shape's bytes depend on."""
    libraries = {name: version(name) for name in LIBRARIES}
    return {"python": platform.python_version(), **libraries, **installed_versions(BUILDS)}


def other_libraries() -> tuple[str, ...]:
    """Name the libraries whose installed versions did not make ``minitouch-1000``."""
    made_with = canonical_shape_set().document["versions"]
    return tuple(
        f"{name} {version(name)} (not {made_with[name]})"
        for name in LIBRARIES[1:]  # numpy draws the same numbers in every version
        if version(name) != made_with[name]
    )


def write_set(
    folder: Path, header: Mapping[str, Any], made: Sequence[tuple[Mapping[str, Any], bytes]]
) -> dict[str, Any]:
    """Write pack and manifest from entries and records in order; return the manifest.

    Raises:
        InfrastructureError: the folder cannot be written.
    """
    families = [entry["family"] for entry, _ in made]
    splits = splits_of(header.get("seed"), families, [digest(record) for _, record in made])
    shapes, offset = [], 0
    for (entry, record), split in zip(made, splits, strict=True):
        shapes.append({**entry, "split": split, "offset": offset, "length": len(record)})
        offset += len(record)
    pack = b"".join(record for _, record in made)
    document = {
        "schema": SCHEMA,
        **header,
        "versions": versions(),
        "count": len(shapes),
        "pack_sha256": digest(pack),
        "shapes": shapes,
    }
    with os_errors_as(InfrastructureError, folder, "written"):
        replace_file(folder / PACK, pack)
        replace_file(folder / MANIFEST, manifest_text(document).encode())
    return document


def manifest_text(document: Mapping[str, Any]) -> str:
    """Return a manifest with one line per shape, so that a difference can be read."""
    head = {key: value for key, value in document.items() if key != "shapes"}
    top = json.dumps(head, indent=1, allow_nan=False)[:-2]
    rows = ",\n".join(json.dumps(entry, allow_nan=False) for entry in document["shapes"])
    return f'{top},\n "shapes": [\n{rows}\n ]\n}}\n'
