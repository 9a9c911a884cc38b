"""Generate a set, resumable, always the same bytes; and how any set is written."""

import base64
import json
import platform
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import coacd
import numpy as np
from msgspec import to_builtins

from minitouch_bench.errors import InfrastructureError, RunDirectoryError
from minitouch_bench.files import (
    damage_as,
    entries_of,
    lock_directory,
    os_errors_as,
    refuse_entries,
    replace_file,
)
from minitouch_bench.machine import installed_versions
from minitouch_bench.processes import run_in_workers
from minitouch_bench.protocol.spec import content_digest
from minitouch_bench.shapegen import soundness
from minitouch_bench.shapegen.body_codec import Body, body_files, decode, digest, encode, quantized
from minitouch_bench.shapegen.families import FAMILIES, GENERATOR_VERSION
from minitouch_bench.shapegen.geometry import Mesh, Points, in_body_frame, solid_moments
from minitouch_bench.shapegen.manifest import MANIFEST, PACK, SCHEMA, splits_of
from minitouch_bench.shapegen.solids import Solid, hull_of, simplified, to_mesh, to_solid
from minitouch_bench.shapegen.soundness import LIMITS, Reason, SoundnessConfig, UnsoundError
from minitouch_bench.simulation.builds import BUILDS

Progress = Callable[[int, int], None]
"""Called with (done, total)."""

PARTIAL = "shapes.partial"
"""An interrupted generation: a line with its settings, then a line per finished shape."""

LIBRARIES = ("numpy", "coacd", "manifold3d", "fast-simplification")


def generate(
    folder: Path, count: int, root: int, workers: int, progress: Progress = lambda *_: None
) -> str:
    """Make shapes 0 to ``count`` - 1 of seed ``root``, write them as a set, and return its digest.

    After an interruption the same call makes the shapes that are missing.

    Raises:
        RunDirectoryError: another generator works in the folder, or it holds a set or other files.
        InfrastructureError: the disk is full, or a worker failed.
    """
    name = f"minitouch-{count}" + (f"-seed-{root}" if root else "")
    header = {"name": name, "generator": GENERATOR_VERSION, "seed": root}
    header["parameters"] = asdict(BUILD)
    with lock_directory(folder):
        if (folder / MANIFEST).exists():
            raise RunDirectoryError(f"{folder} contains a finished set; choose another --output")
        refuse_others(folder, PARTIAL, PACK)
        partial = folder / PARTIAL
        made = made_before(partial, {**header, "versions": versions(), "count": count})
        tasks = [(root, index) for index in range(count) if index not in made]
        progress(len(made), count)
        for position, (entry, record) in run_in_workers(
            make_shape, tasks, workers, name=lambda t: f"shape {t[1]}"
        ):
            index = tasks[position][1]
            made[index] = entry, record
            line = json.dumps([index, entry, base64.b64encode(record).decode()], allow_nan=False)
            hint = "; the shapes made so far are kept: make room and run the same command again"
            with (
                os_errors_as(InfrastructureError, partial, "written", hint),
                partial.open("a") as file,
            ):
                file.write(f"{line}\n")
            progress(len(made), count)
        document = write_set(folder, header, [made[index] for index in range(count)])
        partial.unlink()
    return content_digest(document)


def refuse_others(folder: Path, *own: str) -> None:
    """Refuse a folder with other files than ``own``, which an interrupted call leaves there.

    Raises:
        RunDirectoryError: it has some.
    """
    others = {*entries_of(folder)} - {*own}
    refuse_entries(folder, others, "It does not contain a set; choose another --output")


def made_before(partial: Path, plan: Mapping[str, Any]) -> dict[int, tuple[dict[str, Any], bytes]]:
    """Return the entries and records by number that a generation has finished; begin a new one.

    Raises:
        RunDirectoryError: it was begun with other settings, or is damaged.
        InfrastructureError: the folder cannot be written.
    """
    head = json.dumps(plan, sort_keys=True).encode() + b"\n"
    found = partial.read_bytes().splitlines(keepends=True) if partial.exists() else [head]
    if found[:1] != [head]:
        raise RunDirectoryError(
            f"{partial} was begun with other settings; delete it or choose another --output"
        )
    whole = [line for line in found if line.endswith(b"\n")]  # a kill can cut the last one
    with os_errors_as(InfrastructureError, partial, "written"):
        replace_file(partial, b"".join(whole))
    what = f"{partial} is damaged; delete it or choose another --output"
    with damage_as(RunDirectoryError, what):
        shapes = [json.loads(line) for line in whole[1:]]
        return {index: (entry, base64.b64decode(record)) for index, entry, record in shapes}


def versions() -> dict[str, str]:
    """Return the versions of everything a shape's bytes depend on."""
    return {"python": platform.python_version(), **installed_versions((*LIBRARIES, *BUILDS))}


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


@dataclass(frozen=True)
class DecompositionConfig:
    """Settings of CoACD; ``threshold`` is its concavity bound, relative to the shape's size.

    ``longest_edge`` (m): longer edges are split first. On long thin triangles, such as those
    round a hole in a flat face, the search took 25 s and found worse hulls.
    """

    threshold: float = 0.1
    iterations: int = 20
    depth: int = 2
    max_hulls: int = 16
    max_hull_vertices: int = 64
    resolution: int = 1000
    longest_edge: float = 0.02
    seed: int = 0


@dataclass(frozen=True)
class BuildConfig:
    """How shapes are drawn; lengths in m, density in kg/m³.

    ``sides``: the sides of a shape's box along its axes, before it has its size. ``width``: how
    wide it is then, in the pose in which the tasks lay it down, over all yaws. ``density`` runs
    from aluminum to lead.
    """

    faces: int = 400
    sides: tuple[float, float] = (0.9, 1.25)
    width: tuple[float, float] = (0.070, 0.0755)
    density: tuple[float, float] = (2700.0, 11340.0)
    attempts: int = 400
    decomposition: DecompositionConfig = DecompositionConfig()
    soundness: SoundnessConfig = LIMITS


BUILD = BuildConfig()
"""How every shape is made; a set's manifest holds it."""


NEAR_COPIES = frozenset({(0, 244), (0, 743), (0, 772), (0, 919), (0, 991)})
"""Seed of the set and number of the shapes whose first sound draw is nearly another shape.

``python -m benchmarks.shape_evidence`` found them in the whole set, as ``shapes check`` finds
exact copies only; they take their next sound draw.
"""


def make_shape(task: tuple[int, int]) -> tuple[dict[str, Any], bytes]:
    """Return the manifest's entry and the record of a shape, of (seed of the set, index).

    Every attempt has its own random stream, so nothing depends on other shapes. ``refused`` in
    the entry counts the draws before it by reason. Runs in a worker.

    Raises:
        InfrastructureError: no attempt gave a sound shape.
    """
    root, index = task
    family = tuple(FAMILIES)[index % len(FAMILIES)]
    refused: Counter[str] = Counter()
    for attempt in range(BUILD.attempts):
        rng = np.random.default_rng(np.random.SeedSequence([root, index, attempt]))
        try:
            mesh = sized(FAMILIES[family](rng), rng)
            density = drawn_density(mesh, rng)
            body = weighed(mesh, density)
            measures = soundness.check_body(body)
            if task in NEAR_COPIES and not refused[Reason.COPY.name]:
                raise UnsoundError(Reason.COPY)
        except UnsoundError as error:
            refused[error.reason.name] += 1
            continue
        entry = {
            "name": f"shape-{index:04d}",
            "family": family,
            "attempt": attempt,
            "refused": dict(sorted(refused.items())),
            **entry_of(body, measures, density),
        }
        return entry, encode(body)
    raise InfrastructureError(f"shape {index} ({family}): no sound shape in {BUILD.attempts} draws")


def record_facts(body: Body) -> dict[str, Any]:
    """Return the manifest's fields that can be recomputed from the record alone, SI units."""
    return {
        "mass_kg": body.mass,
        "extents_m": [round(side, 6) for side in body.visual.extents.tolist()],
        "faces": len(body.visual.faces),
        "hulls": len(body.hulls),
        "hull_vertices": sum(len(hull.vertices) for hull in body.hulls),
        "sha256": digest(encode(body)),
        "files_sha256": digest(*body_files(body).values()),
    }


def entry_of(body: Body, measures: Mapping[str, Any], density: float) -> dict[str, Any]:
    """Return the manifest's entry of a body, SI units; mass and poses are not rounded."""
    return {**record_facts(body), "density": round(density, 3), **to_builtins(measures)}


def sized(solid: Solid, rng: np.random.Generator) -> Mesh:
    """Simplify a drawn solid, bring it into its body frame and give it a random size.

    Raises:
        UnsoundError: it is not a single closed body, or no size fits both hand and bounds.
    """
    mesh = simplified(to_mesh(solid), BUILD.faces)
    check = to_solid(mesh)
    if check.is_empty() or check.volume() <= 0.0:
        raise UnsoundError(Reason.NOT_CLOSED)
    mesh = in_body_frame(mesh)
    # Solid parts as long as wide: what is flat or thin is hardly felt by a hand above it.
    sides = np.sort(rng.uniform(*BUILD.sides, size=3))[::-1]
    mesh = in_body_frame(Mesh(mesh.vertices * (sides / mesh.extents), mesh.faces))
    factor = soundness.grip_scale(mesh, rng.uniform(*BUILD.width))
    try:
        mesh = Mesh(quantized(mesh.vertices * factor), mesh.faces)
    except ValueError as error:
        raise UnsoundError(Reason.SIZE, str(error)) from error
    soundness.check_mesh(mesh)
    return mesh


def drawn_density(mesh: Mesh, rng: np.random.Generator) -> float:
    """Draw a density (kg/m³), its logarithm uniform over what keeps the mass within bounds.

    Raises:
        UnsoundError: nothing does.
    """
    volume = solid_moments(mesh).volume
    low = max(BUILD.density[0], LIMITS.mass[0] * 1.0001 / volume)
    high = min(BUILD.density[1], LIMITS.mass[1] * 0.9999 / volume)
    if low > high:
        raise UnsoundError(Reason.MASS)
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def weighed(mesh: Mesh, density: float) -> Body:
    """Return the body of a mesh on the grid and in its frame, at a density in kg/m³."""
    moments = solid_moments(mesh)
    hulls = tuple(hull_of(quantized(points)) for points in convex_parts(mesh))
    ixx, iyy, izz = (np.diag(moments.inertia) * density).tolist()
    body = Body(mesh, hulls, moments.volume * density, (ixx, iyy, izz))
    return decode(encode(body))  # what is proven is what is stored


def convex_parts(mesh: Mesh) -> list[Points]:
    """Cover a closed mesh with convex hulls, (N, 3) points each.

    CoACD can end the process: use a worker.
    """
    config = BUILD.decomposition
    coacd.set_log_level("error")
    fine = to_mesh(to_solid(mesh).refine_to_length(config.longest_edge))
    parts = coacd.run_coacd(
        coacd.Mesh(fine.vertices, fine.faces),
        threshold=config.threshold,
        mcts_iterations=config.iterations,
        mcts_max_depth=config.depth,
        max_convex_hull=config.max_hulls,
        decimate=True,
        max_ch_vertex=config.max_hull_vertices,
        resolution=config.resolution,
        preprocess_mode="off",
        seed=config.seed,
    )
    return [np.asarray(vertices, dtype=np.float64) for vertices, _ in parts]
