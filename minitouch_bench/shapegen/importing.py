"""Turn OBJ, STL, GLB and URDF objects into a set, or say why each one cannot be."""

import math
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import trimesh

from minitouch_bench.errors import UsageError
from minitouch_bench.files import lock_directory
from minitouch_bench.processes import run_in_workers
from minitouch_bench.protocol.spec import content_digest
from minitouch_bench.shapegen.build import BUILD, entry_of, weighed
from minitouch_bench.shapegen.generate import Progress, write_set
from minitouch_bench.shapegen.manifest import MANIFEST
from minitouch_bench.shapegen.mesh import Mesh, in_body_frame, solid_moments
from minitouch_bench.shapegen.reading import UnreadableError, find_objects, read_object
from minitouch_bench.shapegen.record import encode, quantized
from minitouch_bench.shapegen.solids import Solid, hull_of, simplified, to_mesh, to_solid
from minitouch_bench.shapegen.soundness import (
    LIMITS,
    Reason,
    UnsoundError,
    check_mesh,
    examine,
    grip_scale,
    stable_poses,
)

FAMILY = "imported"
LONGEST_STEM = 150
"""Characters of a file's name that its shape keeps."""


@dataclass(frozen=True)
class ImportConfig:
    """How objects become shapes.

    ``scale`` turns the files' units into m. ``fit`` then shrinks or grows each object into the
    size the Panda can grip. ``density`` in kg/m³, moved to the nearest at which the
    mass is within the bounds of a shape.

    Raises:
        UsageError: ``scale`` is not a number above 0.
    """

    scale: float = 1.0
    fit: bool = False
    density: float = 1000.0

    def __post_init__(self) -> None:
        if not 0.0 < self.scale < math.inf:
            raise UsageError(f"--scale is a number above 0, not {self.scale:g}")


@dataclass(frozen=True)
class ImportResult:
    """The set made ("" as digest if nothing was accepted), and each refusal by file."""

    folder: Path
    digest: str
    accepted: int
    refused: dict[str, str]

    def reasons(self) -> dict[str, int]:
        """Return the number of refusals by reason, without the measured number."""
        return dict(Counter(text.partition(" (")[0] for text in self.refused.values()))


def import_objects(
    source: Path,
    folder: Path,
    config: ImportConfig,
    workers: int = 1,
    progress: Progress = lambda *_: None,
) -> ImportResult:
    """Import every object below ``source`` into a new set in ``folder``.

    Raises:
        UsageError: there are no objects, or ``folder`` holds a set already.
        RunDirectoryError: another process works there.
        InfrastructureError: the folder cannot be written, or a worker died.
    """
    paths = find_objects(source)
    if (folder / MANIFEST).exists():
        raise UsageError(f"{folder} holds a shape set already; choose another --output")
    answers: dict[int, Any] = {}
    with lock_directory(folder):
        tasks = [(str(path), config) for path in paths]
        for position, answer in run_in_workers(
            import_one, tasks, workers, name=lambda task: task[0]
        ):
            answers[position] = answer
            progress(len(answers), len(paths))
        names = [str(path.relative_to(source)) for path in paths]
        refused = {names[i]: answers[i][0] for i in sorted(answers) if answers[i][0]}
        kept = [
            ({"name": name, "family": FAMILY, "source": names[i], **answers[i][1]}, answers[i][2])
            for i, name in enumerate(_plain_names(names)) if not answers[i][0]
        ]  # fmt: skip
        digest = ""
        if kept:
            header = {"name": folder.name, "imported": {"scale": config.scale, "fit": config.fit}}
            digest = content_digest(write_set(folder, {**header, "refused": refused}, kept))
    return ImportResult(folder, digest, len(kept), refused)


def import_one(task: tuple[str, ImportConfig]) -> tuple[str, dict[str, Any], bytes]:
    """Return (reason refused or "", entry, record) of one file; runs in a worker."""
    path, config = task
    try:
        mesh = repaired(read_object(Path(path)), config)
        return "", *_proven(mesh, config)
    except (UnreadableError, UnsoundError) as error:
        return str(error), {}, b""


def repaired(mesh: Mesh, config: ImportConfig) -> Mesh:
    """Return a closed mesh of about 400 faces in its body frame, sized by the config.

    Raises:
        UnreadableError: it holds no solid that can be repaired.
        UnsoundError: at no size can the Panda grip it.
    """
    if not np.isfinite(mesh.vertices).all():
        raise UnreadableError("a vertex, mass or moment is not a finite number")
    solid = _solid_of(mesh)
    if solid.is_empty() or solid.volume() <= 0.0:
        raise UnreadableError("not a closed 2-manifold, and no repair made it one")
    moved = in_body_frame(_simplified_solid(solid, BUILD.faces))
    factor = config.scale
    if config.fit:
        factor = grip_scale(moved, BUILD.width[1])
    try:
        mesh = Mesh(quantized(moved.vertices * factor), moved.faces)
        # Slivers may have lost their area to the grid; the way through a solid drops them.
        cleaned = to_mesh(to_solid(mesh))
        return Mesh(quantized(cleaned.vertices), cleaned.faces)
    except ValueError:
        longest = float(moved.extents.max()) * factor * 1000.0
        raise UnreadableError(f"{Reason.SIZE} ({longest:.1f} mm)") from None


def _simplified_solid(solid: Solid, faces: int) -> Mesh:
    """Return a closed mesh of at most about ``faces`` faces, where that can be had."""
    mesh = to_mesh(solid)
    for target in (faces, faces * 7 // 8, faces * 3 // 4):
        small = simplified(mesh, target)
        check = to_solid(small)
        if not check.is_empty() and check.volume() > 0.0 and len(check.decompose()) == 1:
            return small
    # Slower to shrink and coarser, but it never breaks a closed surface.
    tolerance = float(mesh.extents.max()) / 1000.0
    for _ in range(6):
        if solid.num_tri() <= faces:
            break
        solid, tolerance = solid.simplify(tolerance), 1.6 * tolerance
    return to_mesh(solid)


def _solid_of(mesh: Mesh) -> Solid:
    """Return the solid of a mesh: as it is, or repaired, and as one body where parts overlap."""
    solid = to_solid(mesh)
    if solid.is_empty():
        parts = _repaired_parts(mesh)
    elif solid.volume() < 0.0:
        return to_solid(Mesh(mesh.vertices, mesh.faces[:, ::-1]))
    else:
        parts = list(solid.decompose())
    if any(part.is_empty() for part in parts):
        return Solid()
    # A part of negative volume is a cavity, which a union would fill.
    if len(parts) > 1 and any(part.volume() < 0.0 for part in parts):
        return solid
    if len(parts) == 1:
        return parts[0]
    return Solid.batch_boolean(_swollen(parts), manifold3d.OpType.Add)


def _repaired_parts(mesh: Mesh) -> list[Solid]:
    """Split a mesh where more than two faces meet, then close and turn each part outward."""
    whole: Any = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
    solids = []
    for part in whole.split(only_watertight=False, repair=False):
        trimesh.repair.fill_holes(part)
        part.fix_normals(multibody=False)  # a part is one body
        vertices = np.asarray(part.vertices, dtype=np.float64)
        solids.append(to_solid(Mesh(vertices, np.asarray(part.faces, dtype=np.int32))))
    return solids or [Solid()]


def _swollen(parts: list[Solid]) -> list[Solid]:
    """Grow parts by a thousandth, so that hulls which only touch become one body."""
    grown = []
    for part in parts:
        low, high = np.array(part.bounding_box()).reshape(2, 3)
        middle = (low + high) / 2.0
        part_at_zero = part.translate((-middle).tolist()).scale([1.002, 1.002, 1.002])
        grown.append(part_at_zero.translate(middle.tolist()))
    return grown


def _proven(mesh: Mesh, config: ImportConfig) -> tuple[dict[str, Any], bytes]:
    """Return entry and record of a mesh that passes every criterion.

    Raises:
        UnsoundError: it does not.
    """
    check_mesh(mesh)
    stable_poses(hull_of(mesh.vertices))
    volume = solid_moments(mesh).volume
    low, high = (mass / volume for mass in LIMITS.mass)
    density = float(np.clip(config.density, low * 1.0001, high * 0.9999))
    body = weighed(mesh, density)
    return entry_of(body, examine(body), density), encode(body)


def _plain_names(sources: Iterable[str]) -> list[str]:
    """Return a shape's name for each file, fit for ``PLAIN_NAME``, no two alike."""
    names: dict[str, None] = {}
    for source in sources:
        plain = re.sub("[^A-Za-z0-9._-]+", "_", source.rpartition(".")[0].replace("/", "-"))
        stem = name = plain.lstrip("._-")[:LONGEST_STEM] or "object"
        number = 1
        while name in names:
            number += 1
            name = f"{stem}-{number}"
        names[name] = None
    return list(names)
