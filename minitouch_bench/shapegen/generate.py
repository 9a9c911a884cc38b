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
from minitouch_bench.files import lock_directory, os_errors_as, read_file, replace_file
from minitouch_bench.processes import run_in_workers
from minitouch_bench.shapegen.build import BuildConfig, make_shape
from minitouch_bench.shapegen.families import GENERATOR_VERSION
from minitouch_bench.shapegen.manifest import MANIFEST, PACK, SCHEMA, content_digest, splits_of
from minitouch_bench.shapegen.record import digest

PARTIAL, PLAN = ".partial", "plan.json"
Progress = Callable[[int, int], None]
"""Called with (done, total)."""

LIBRARIES = ("numpy", "coacd", "manifold3d", "fast-simplification", "pybullet")


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
    """Make shapes 0 to ``count`` - 1 of seed ``root`` and write them as a set.

    What an interrupted generation had made is kept and used.

    Raises:
        RunDirectoryError: another generator works in the folder, or it holds something else.
        InfrastructureError: the disk is full, or a worker failed.
    """
    header = {
        "name": f"minitouch-{count}" + (f"-seed-{root}" if root else ""),
        "generator": GENERATOR_VERSION,
        "seed": root,
        "parameters": asdict(BuildConfig()),
    }
    with lock_directory(folder):
        partial = opened_partial(folder, {**header, "versions": versions(), "count": count})
        missing = [i for i in range(count) if read_partial(partial, i) is None]
        progress(count - len(missing), count)
        tasks = [(root, index) for index in missing]
        for done, (position, (entry, record)) in enumerate(
            run_in_workers(make_shape, tasks, workers, name=lambda task: f"shape {task[1]}"),
            start=1,
        ):
            write_partial(partial, missing[position], entry, record)
            progress(count - len(missing) + done, count)
        made = [found for i in range(count) if (found := read_partial(partial, i)) is not None]
        document = write_set(folder, header, made)
        shutil.rmtree(partial)
    refused = sum((Counter(entry["refused"]) for entry, _ in made), Counter[str]())
    return GenerateResult(folder, content_digest(document), count, refused)


def opened_partial(folder: Path, plan: dict[str, Any]) -> Path:
    """Return the folder of single shapes, begun with this plan or fresh.

    Raises:
        RunDirectoryError: a finished set, or shapes of another plan, are there already.
        InfrastructureError: it cannot be written.
    """
    partial = folder / PARTIAL
    text = json.dumps(plan, sort_keys=True).encode()
    with os_errors_as(InfrastructureError, partial, "written"):
        if (partial / PLAN).exists():
            if read_file(partial / PLAN) != text:
                raise RunDirectoryError(
                    f"{folder} holds a generation begun with other settings; "
                    f"delete {partial} or choose another --output"
                )
        elif (folder / MANIFEST).exists():
            raise RunDirectoryError(f"{folder} holds a finished set; choose another --output")
        else:
            partial.mkdir(exist_ok=True)
            replace_file(partial / PLAN, text)
    return partial


def write_partial(partial: Path, index: int, entry: dict[str, Any], record: bytes) -> None:
    """Keep one shape.

    Raises:
        InfrastructureError: the disk is full; what was made before stays.
    """
    text = json.dumps(entry, allow_nan=False).encode()
    hint = "; the shapes made so far are kept: make room and run the same command again"
    with os_errors_as(InfrastructureError, partial, "written", hint):
        replace_file(partial / f"{index}.shape", text + b"\n" + record)


def read_partial(partial: Path, index: int) -> tuple[dict[str, Any], bytes] | None:
    """Return a kept shape, or None if there is none or it is damaged."""
    try:
        text, _, record = read_file(partial / f"{index}.shape").partition(b"\n")
        entry: dict[str, Any] = json.loads(text)
    except (OSError, ValueError):
        return None
    return (entry, record) if entry.get("sha256") == digest(record) else None


def versions() -> dict[str, str]:
    """Return the versions of everything a shape's bytes depend on."""
    return {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}}


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
