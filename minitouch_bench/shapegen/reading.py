"""Read strangers' meshes with care: sizes are bounded before anything is parsed."""

import re
import warnings
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import trimesh

from minitouch_bench.errors import UsageError
from minitouch_bench.files import MIB, read_file
from minitouch_bench.shapegen.mesh import Mesh, Points

SUFFIXES = (".urdf", ".obj", ".stl", ".glb")
"""Read in this order: a URDF claims the meshes it names, which then do not count again."""
MOST_FACES = 500_000
MOST_BYTES = 64 * MIB
"""More than half a million faces of any of these formats."""


class UnreadableError(Exception):
    """A file holds no mesh we can use; the text says why, in few words."""


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
            claimed.update(name.resolve() for name, _ in _urdf_meshes(path, strict=False))
    objects = [path for path in files if path.resolve() not in claimed]
    if not objects:
        raise UsageError(f"{folder} contains no object: looked for {', '.join(SUFFIXES)}")
    return objects


def read_object(path: Path) -> Mesh:
    """Return the mesh of one file in the file's units; a URDF's is its first link's collision.

    Raises:
        UnreadableError: it is no mesh, too large, empty, or has vertices that are not finite.
    """
    if path.suffix.lower() == ".urdf":
        meshes = [(read_object(name), placed) for name, placed in _urdf_meshes(path)]
        if not meshes:
            raise UnreadableError("the URDF names no mesh")
        joined: Any = trimesh.util.append_faces(
            [trimesh.transform_points(mesh.vertices, placed) for mesh, placed in meshes],
            [mesh.faces for mesh, _ in meshes],
        )
        return Mesh(joined[0], joined[1].astype(np.int32))
    _check_size(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            loaded: Any = trimesh.load(str(path), force="mesh", process=False)
        vertices = np.asarray(loaded.vertices, dtype=np.float64)
        faces = np.asarray(loaded.faces, dtype=np.int32)
    except Exception as error:  # each parser of each format raises its own kinds
        raise UnreadableError(f"no readable {path.suffix} file ({type(error).__name__})") from error
    if len(faces) == 0 or vertices.ndim != 2:
        raise UnreadableError("no faces in the file")
    if len(faces) > MOST_FACES:
        raise UnreadableError(f"more than {MOST_FACES} faces ({len(faces)})")
    if not np.isfinite(vertices).all():
        raise UnreadableError("a vertex, mass or moment is not a finite number")
    return _welded(Mesh(vertices, faces))


def _check_size(path: Path) -> None:
    """Refuse a file too large to parse, without reading it."""
    try:
        size = path.stat().st_size
    except OSError as error:
        raise UnreadableError(f"cannot be read: {error.strerror}") from error
    if size > MOST_BYTES:
        raise UnreadableError(
            f"file over {MOST_BYTES // MIB} MB, which means more than {MOST_FACES} faces"
        )


def _welded(mesh: Mesh) -> Mesh:
    """Join vertices at the same place (STL repeats each), and drop faces left with no area."""
    points, inverse = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = inverse.reshape(-1)[mesh.faces].astype(np.int32)
    kept = (
        (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    )
    return Mesh(points, faces[kept])


def _urdf_meshes(path: Path, strict: bool = True) -> list[tuple[Path, Points]]:
    """Return the collision meshes of a one-link URDF, each with its transform into the link.

    Raises:
        UnreadableError: ``strict`` and it is not a URDF of a single link made of meshes.
    """
    try:
        text = read_file(path, MIB, follow=True).decode(errors="replace")
        if re.search(r"<!(DOCTYPE|ENTITY)", text):
            raise ElementTree.ParseError("entities are not read")
        root = ElementTree.fromstring(text)
    except (OSError, ElementTree.ParseError) as error:
        if strict:
            raise UnreadableError("no readable .urdf file") from error
        return []
    links = root.findall("link")
    if strict and len(links) != 1:
        raise UnreadableError(f"a URDF of {len(links)} links, not one")
    meshes: list[tuple[Path, Points]] = []
    for link in links:
        kind = "visual" if link.find("collision/geometry/mesh") is None else "collision"
        for element in link.findall(kind):
            try:
                meshes.append(_placed_mesh(path, element))
            except UnreadableError:
                if strict:
                    raise
    if strict and any(file.suffix.lower() == ".urdf" for file, _ in meshes):
        raise UnreadableError("the URDF names a URDF as its mesh")
    return meshes


def _placed_mesh(path: Path, element: ElementTree.Element) -> tuple[Path, Points]:
    """Return the mesh of a collision or visual element, and its transform, float64 (4, 4).

    Raises:
        UnreadableError: it is another geometry, or its scale or origin is damaged.
    """
    mesh, origin = element.find("geometry/mesh"), element.find("origin")
    if mesh is None:
        raise UnreadableError("a geometry of the URDF is not a mesh")
    name = mesh.get("filename", "").removeprefix("package://")
    placed: Points = trimesh.transformations.compose_matrix(  # type: ignore[no-untyped-call]
        scale=_three(mesh, "scale", "1 1 1"),
        angles=_three(origin, "rpy", "0 0 0"),
        translate=_three(origin, "xyz", "0 0 0"),
    )
    return path.parent / name, placed


def _three(element: ElementTree.Element | None, key: str, default: str) -> tuple[float, ...]:
    text = default if element is None else element.get(key, default)
    try:
        x, y, z = (float(part) for part in text.split())
    except ValueError as error:
        raise UnreadableError(f"the URDF's {key} is not three numbers") from error
    return x, y, z
