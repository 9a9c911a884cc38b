"""Exchange shapes with other programs: objects become a set, or a set becomes files.

An object is an OBJ, STL or GLB file of a watertight mesh, or a URDF of one link. Files can be a
stranger's: their sizes are bounded before anything is parsed, and only meshes that a URDF names are
opened beside them.
"""

import io
import math
import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import trimesh

from minitouch_bench.errors import InfrastructureError, RunDirectoryError, UsageError
from minitouch_bench.files import MIB, lock_directory, os_errors_as, read_file, replace_file
from minitouch_bench.processes import run_in_workers
from minitouch_bench.protocol.spec import content_digest
from minitouch_bench.shapegen import solids, soundness
from minitouch_bench.shapegen.body_codec import Body, body_files, encode, obj_text, quantized
from minitouch_bench.shapegen.generate import BUILD, Progress, entry_of, weighed, write_set
from minitouch_bench.shapegen.manifest import MANIFEST, ShapeSet
from minitouch_bench.shapegen.mesh import Mesh, Points, in_body_frame, rest_poses, solid_moments

FAMILY = "imported"
LONGEST_STEM = 150
"""Characters of a file's name that its shape keeps."""

NOT_WATERTIGHT = (
    "not a watertight mesh; repair it in another program, such as Blender (3D Print Toolbox) "
    "or MeshLab, and import it again"
)
SUFFIXES = (".urdf", ".obj", ".stl", ".glb")
"""What an object is read from; the meshes that a URDF names do not count again."""
MOST_FACES = 500_000
MOST_BYTES = 64 * MIB
"""More than half a million faces of any of these formats."""


LENGTH = (0.010, 0.125)
"""Twice the way from the center of mass to the farthest end, m; a record stores up to 0.13."""
SEEN_LENGTH = 0.04
"""Of a compact object that the policy's camera sees, m."""
USUAL_DENSITY = 1000.0
"""That of water, kg/m³."""
UNITS = (1.0, 0.001, 0.01, 0.0254)
"""Meters in what the unit of a file can be: m, mm, cm, inches."""


class UnreadableError(Exception):
    """A file holds no mesh we can use; the text says why, in few words."""


@dataclass(frozen=True)
class ImportConfig:
    """How objects become shapes.

    ``scale`` turns the files' units into m. ``fit`` then shrinks or grows each object into the
    size the Panda can grip. ``density`` in kg/m³; without one the nearest to 1000 at which the
    mass is within the bounds of a shape.

    Raises:
        UsageError: ``scale`` is not a number above 0.
    """

    scale: float = 1.0
    fit: bool = False
    density: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.scale < math.inf:
            raise UsageError(f"--scale is a number above 0, not {self.scale:g}")


@dataclass(frozen=True)
class ImportResult:
    """The set made ("" as digest if nothing was accepted), and each refusal by file.

    ``not_promised``: what is promised of the thousand shapes and not of this object, by file.
    """

    digest: str
    accepted: int
    refused: dict[str, str]
    not_promised: dict[str, list[str]]


def import_objects(
    source: Path,
    folder: Path,
    config: ImportConfig,
    workers: int = 1,
    progress: Progress = lambda *_: None,
) -> ImportResult:
    """Import every object below ``source`` into a new set in ``folder``.

    Raises:
        UsageError: there are no objects.
        RunDirectoryError: ``folder`` holds a set already, or another process works there.
        InfrastructureError: the folder cannot be written, or a worker died.
    """
    paths = find_objects(source)
    answers: dict[int, Any] = {}
    with lock_directory(folder):
        if (folder / MANIFEST).exists():
            raise RunDirectoryError(f"{folder} holds a shape set already; choose another --output")
        tasks = [(path, config) for path in paths]
        for place, answer in run_in_workers(import_one, tasks, workers, name=lambda t: str(t[0])):
            answers[place] = answer
            progress(len(answers), len(paths))
        names = [str(path.relative_to(source)) for path in paths]
        refused, not_promised, kept, digest = {}, {}, [], ""
        for number, (name, plain) in enumerate(zip(names, _plain_names(names), strict=True)):
            reason, entry, record = answers[number]
            if reason:
                refused[name] = reason
            else:
                not_promised[name] = entry["not_promised"]
                kept.append(({"name": plain, "family": FAMILY, "source": name, **entry}, record))
        if kept:
            header = {"name": folder.name, "imported": {"scale": config.scale, "fit": config.fit}}
            digest = content_digest(write_set(folder, {**header, "refused": refused}, kept))
    return ImportResult(digest, len(kept), refused, not_promised)


def import_one(task: tuple[Path, ImportConfig]) -> tuple[str, dict[str, Any], bytes]:
    """Return (reason refused or "", entry, record) of one file; runs in a worker."""
    path, config = task
    missed: dict[soundness.Reason, str] = {}
    try:
        mesh = prepared(read_object(path), config)
        soundness.check_mesh(mesh, missed.__setitem__)  # before CoACD, which takes long
        volume = solid_moments(mesh).volume
        low, high = (mass / volume for mass in soundness.LIMITS.mass)
        density = config.density or float(np.clip(USUAL_DENSITY, low * 1.0001, high * 0.9999))
        body = weighed(mesh, density)
        measures = soundness.examine(body, missed.__setitem__)
        soundness.check_usable(body, measures["poses"][0], missed.__setitem__)
    except UnreadableError as error:
        return str(error), {}, b""
    except soundness.UnsoundError as error:
        scale = config.scale * error.factor
        advice = f"; accepted with --scale {scale:.3g}" if scale and not config.fit else ""
        return f"{error}{advice}", {}, b""
    not_promised = [f"{reason} ({detail})" for reason, detail in missed.items()]
    return "", {**entry_of(body, measures, density), "not_promised": not_promised}, encode(body)


def prepared(mesh: Mesh, config: ImportConfig) -> Mesh:
    """Return a closed mesh of about 400 faces in its body frame, sized by the config.

    Raises:
        UnreadableError: it is not watertight.
        UnsoundError: it is too long or too short.
    """
    solid = _solid_of(mesh)
    if solid.volume() <= 0.0:
        raise UnreadableError(NOT_WATERTIGHT)
    moved = in_body_frame(solids.simplified_solid(solid, BUILD.faces))
    factor = _fitting(moved) if config.fit else config.scale
    longest, (low, high) = 2.0 * float(np.abs(moved.vertices).max()), LENGTH
    if not low <= longest * factor <= high:
        units = (unit / factor for unit in UNITS if low <= longest * unit <= high)
        hull = solids.hull_of(moved.vertices)
        excess = soundness.lying_excess(hull, rest_poses(hull)[0])
        most = 0.99 * min(high / longest, 1.0 / excess if excess else math.inf)
        nearest = float(np.clip(factor, SEEN_LENGTH / longest, most)) / factor
        size = soundness.in_mm(longest * factor)
        found = f"{size}, not {low * 1000:.0f} to {soundness.in_mm(high, 0)}"
        raise soundness.UnsoundError(soundness.Reason.SIZE, found, next(units, nearest))
    mesh = Mesh(quantized(moved.vertices * factor), moved.faces)
    # Slivers may have lost their area to the grid; the way through a solid drops them.
    cleaned = solids.to_mesh(solids.to_solid(mesh))
    if not len(cleaned.faces):
        raise soundness.UnsoundError(
            soundness.Reason.THIN_WALL, "nothing of it is left on the grid"
        )
    return Mesh(quantized(cleaned.vertices), cleaned.faces)


def _fitting(mesh: Mesh) -> float:
    """Return a factor that makes a mesh as wide as the hand can grip, or no wider as it lies."""
    try:
        return soundness.grip_scale(mesh, BUILD.width[1])
    except soundness.UnsoundError:
        hull = solids.hull_of(mesh.vertices)
        height, across = soundness.height_and_width(hull, rest_poses(hull)[0])
        return min(BUILD.width[1] / across, soundness.HIGHEST_PUSHED * 0.99 / height)


def _solid_of(mesh: Mesh) -> solids.Solid:
    """Return the solid of a watertight mesh, as one body where its parts overlap or touch.

    Raises:
        UnreadableError: it is not watertight.
    """
    solid = solids.to_solid(mesh)
    if solid.is_empty():
        raise UnreadableError(NOT_WATERTIGHT)
    if solid.volume() < 0.0:  # its faces are turned inward
        return solids.to_solid(Mesh(mesh.vertices, mesh.faces[:, ::-1]))
    parts = list(solid.decompose())
    # A part of negative volume is a cavity, which a union would fill.
    if len(parts) == 1 or any(part.volume() < 0.0 for part in parts):
        return solid
    # Grown by a thousandth on each side, hulls that only touch become one body.
    middles = [np.array(part.bounding_box()).reshape(2, 3).mean(axis=0) for part in parts]
    grown = [
        part.translate((-middle).tolist()).scale([1.002] * 3).translate(middle.tolist())
        for part, middle in zip(parts, middles, strict=True)
    ]
    return solids.union(grown)


def _plain_names(sources: Iterable[str]) -> list[str]:
    """Return a shape's name for each file, fit for ``manifest.PlainName``, no two alike."""
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


def find_objects(folder: Path) -> list[Path]:
    """Return the object files below a folder, sorted, one for each object.

    Raises:
        UsageError: there are none.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder} is no folder")
    files = sorted(p for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES and p.is_file())
    claimed: set[Path] = set()
    for path in files:
        if path.suffix.lower() == ".urdf":
            with suppress(UnreadableError):
                meshes = _urdf_root(path).iter("mesh")
                claimed.update(_named_file(path, mesh).resolve() for mesh in meshes)
    objects = [path for path in files if path.resolve() not in claimed]
    if not objects:
        raise UsageError(f"{folder} contains no object: looked for {', '.join(SUFFIXES)}")
    return objects


def read_object(path: Path) -> Mesh:
    """Return the mesh of one file in the file's units; a URDF's is its link's collision.

    Raises:
        UnreadableError: it is no mesh, too large, empty, or has vertices that are not finite.
    """
    meshes = _read_urdf(path) if path.suffix.lower() == ".urdf" else (_read_mesh(path),)
    joined: Any = trimesh.util.append_faces(
        [mesh.vertices for mesh in meshes], [mesh.faces for mesh in meshes]
    )
    if not np.isfinite(joined[0]).all():
        raise UnreadableError(soundness.Reason.NOT_FINITE)
    return Mesh(joined[0], joined[1].astype(np.int32))


def _read_mesh(path: Path) -> Mesh:
    """Return the mesh of an OBJ, STL or GLB file, each vertex once (STL repeats them)."""
    try:
        content = read_file(path, MOST_BYTES, follow=True)
    except OSError as error:
        raise UnreadableError(f"cannot be read: {error.strerror}") from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # From memory: the materials and buffers that a file names are not opened.
            kind = path.suffix.lower().lstrip(".")
            loaded: Any = trimesh.load(
                io.BytesIO(content), file_type=kind, force="mesh", process=False
            )
        vertices = np.asarray(loaded.vertices, dtype=np.float64)
        faces = np.asarray(loaded.faces, dtype=np.int32)
    except Exception as error:  # each parser of each format raises its own kinds
        raise UnreadableError(f"no readable {path.suffix} file ({type(error).__name__})") from error
    if len(faces) == 0 or vertices.ndim != 2:
        raise UnreadableError("no faces in the file")
    if len(faces) > MOST_FACES:
        raise UnreadableError(f"more than {MOST_FACES} faces ({len(faces)})")
    points, inverse = np.unique(vertices, axis=0, return_inverse=True)
    faces = inverse.reshape(-1)[faces].astype(np.int32)
    return Mesh(points, faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)])


def _read_urdf(path: Path) -> tuple[Mesh, ...]:
    """Return the collision meshes of a URDF of one link, in the link's frame.

    Raises:
        UnreadableError: it is not a URDF of a single link made of meshes.
    """
    links = _urdf_root(path).findall("link")
    if len(links) != 1:
        raise UnreadableError(f"a URDF of {len(links)} links, not one")
    kind = "visual" if links[0].find("collision/geometry/mesh") is None else "collision"
    meshes = []
    for element in links[0].findall(kind):
        mesh, origin = element.find("geometry/mesh"), element.find("origin")
        if mesh is None:
            raise UnreadableError("a geometry of the URDF is not a mesh")
        placed: Points = trimesh.transformations.compose_matrix(  # type: ignore[no-untyped-call]
            scale=_three(mesh, "scale", "1 1 1"),
            angles=_three(origin, "rpy", "0 0 0"),
            translate=_three(origin, "xyz", "0 0 0"),
        )
        read = _read_mesh(_named_file(path, mesh))
        meshes.append(Mesh(trimesh.transform_points(read.vertices, placed), read.faces))
    if not meshes:
        raise UnreadableError("the URDF names no mesh")
    return tuple(meshes)


def _urdf_root(path: Path) -> ElementTree.Element:
    try:
        text = read_file(path, MIB, follow=True).decode(errors="replace")
        if re.search(r"<!(DOCTYPE|ENTITY)", text):
            raise ElementTree.ParseError("entities are not read")
        return ElementTree.fromstring(text)
    except (OSError, ElementTree.ParseError) as error:
        raise UnreadableError("no readable .urdf file") from error


def _named_file(path: Path, mesh: ElementTree.Element) -> Path:
    return path.parent / mesh.get("filename", "").removeprefix("package://")


def _three(element: ElementTree.Element | None, key: str, default: str) -> tuple[float, ...]:
    text = default if element is None else element.get(key, default)
    try:
        x, y, z = (float(part) for part in text.split())
    except ValueError as error:
        raise UnreadableError(f"the URDF's {key} is not three numbers") from error
    return x, y, z


def export(shapes: ShapeSet, folder: Path, form: str, split: str | None = None) -> int:
    """Write every shape, or those of one split, into a folder; return the number of files.

    Raises:
        UsageError: the format or the split is unknown.
        InfrastructureError: the folder cannot be written.
    """
    written = 0
    with os_errors_as(InfrastructureError, folder, "written"):
        folder.mkdir(parents=True, exist_ok=True)
        for shape in shapes.split(split) if split else shapes.shapes:
            for name, content in WRITERS[form](shape.body(), shape.name).items():
                replace_file(folder / name, content)
                written += 1
    return written


def _obj(body: Body, name: str) -> dict[str, bytes]:
    return {f"{name}.obj": obj_text((body.visual,)).encode()}


WRITERS: Mapping[str, Callable[[Body, str], dict[str, bytes]]] = {"urdf": body_files, "obj": _obj}
"""Every export format by name: from a body and its name to file names and their bytes."""
