"""Read the files of objects: OBJ, STL and GLB meshes, and the meshes of a URDF of one link.

Files can be a stranger's: their sizes are bounded before anything is parsed, and only meshes that
a URDF names are opened beside them.
"""

import io
import json
import math
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import manifold3d
import numpy as np
import trimesh

from minitouch_bench.errors import UsageError
from minitouch_bench.files import MIB, read_file
from minitouch_bench.shapegen.geometry import Mesh, Points
from minitouch_bench.shapegen.soundness import Reason

MESHES = (".obj", ".stl", ".glb")
SUFFIXES = (".urdf", *MESHES)
"""What an object is read from; the meshes that a URDF names do not count again."""
MOST_FACES = 500_000
MOST_BYTES = 64 * MIB
"""More than half a million faces of any of these formats."""
SAME_VERTEX = 1e-9
"""Vertices this near each other, as a share of the longest side, are one."""


class UnreadableError(Exception):
    """A file contains no mesh that can be used; the text says why, in few words."""


def find_objects(sources: Sequence[Path]) -> dict[str, Path]:
    """Return the objects among files and below folders by name, sorted, one for each object.

    The name of a file in a folder is its path from there.

    Raises:
        UsageError: there are none, or two of one name, or a source is neither file nor folder.
    """
    objects: dict[str, Path] = {}
    for source in sources:
        if os.path.isdir(source):
            found = (path for path in source.rglob("*") if path.suffix.lower() in SUFFIXES)
            named = {str(path.relative_to(source)): path for path in found if path.is_file()}
        elif not os.path.exists(source):
            raise UsageError(f"{source} does not exist")
        elif source.suffix.lower() not in SUFFIXES:
            raise UsageError(f"{source} is not an OBJ, STL, GLB or URDF file")
        else:
            named = {source.name: source}
        if twice := objects.keys() & named.keys():
            raise UsageError(f"two objects are called '{min(twice)}'; rename one of the files")
        objects |= named
    claimed: set[Path] = set()
    for path in objects.values():
        if path.suffix.lower() == ".urdf":
            claimed.update(file.resolve() for file in _files_of_urdf(path))
    objects = {name: path for name, path in objects.items() if path.resolve() not in claimed}
    if not objects:
        places = ", ".join(map(str, sources))
        raise UsageError(f"{places} contains no object: looked for {', '.join(SUFFIXES)}")
    return dict(sorted(objects.items(), key=lambda item: item[1]))


def read_object(path: Path) -> Mesh:
    """Return the mesh of one file in the file's units; a URDF's is its link's collision.

    Raises:
        UnreadableError: it is no mesh, too large, empty, or has vertices that are not finite.
    """
    return _read_urdf(path) if path.suffix.lower() == ".urdf" else _read_mesh(path)


def _read(path: Path, limit: int) -> bytes:
    try:
        return read_file(path, limit, follow=True)
    except OSError as error:
        raise UnreadableError(f"cannot be read: {error.strerror}") from error


def _read_mesh(path: Path) -> Mesh:
    """Return the mesh of an OBJ, STL or GLB file, each vertex once (STL repeats them)."""
    kind = path.suffix.lower()
    if kind not in MESHES:
        raise UnreadableError(f"a mesh is an OBJ, STL or GLB file, not '{kind}'")
    content = _read(path, MOST_BYTES)
    try:
        vertices, faces = _parse_obj(content) if kind == ".obj" else _parse(content, kind)
    except (UnreadableError, MemoryError):
        raise
    except Exception as error:  # each parser of each format raises its own kinds
        raise UnreadableError(f"no readable {kind} file ({type(error).__name__})") from error
    if len(faces) == 0:
        raise UnreadableError("no faces can be read from it")
    if len(faces) > MOST_FACES:
        raise UnreadableError(f"more than {MOST_FACES} faces ({len(faces)})")
    if not 0 <= faces.min() <= faces.max() < len(vertices):
        raise UnreadableError("a face names a vertex that is not there")
    if not np.isfinite(vertices).all():
        raise UnreadableError(Reason.NOT_FINITE)
    points, place = _merged(vertices)
    faces = place[faces].astype(np.int32)
    return Mesh(points, faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)])


def _parse(content: bytes, kind: str) -> tuple[Points, Any]:
    """Return vertices (V, 3) and faces (F, 3) of an STL or GLB file.

    It is read from memory, without pictures: what a file names is not opened.
    """
    if kind == ".glb":
        header = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
        # Three corners, each with up to six attributes; zeros need no bytes in the file.
        if sum(item["count"] for item in header["accessors"]) > 20 * MOST_FACES:
            raise UnreadableError(f"more than {MOST_FACES} faces")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loaded: Any = trimesh.load(
            io.BytesIO(content),
            file_type=kind[1:],
            force="mesh",
            process=False,
            skip_materials=True,
        )
    return np.asarray(loaded.vertices, dtype=np.float64), np.asarray(loaded.faces)


def _parse_obj(content: bytes) -> tuple[Points, Any]:
    """Return vertices (V, 3) and faces (F, 3) of an OBJ's lines ``v`` and ``f``.

    Trimesh 5.2 counts a negative index from the last vertex of the file, skips indented lines,
    takes the indices 0 and 1 for one vertex, and cuts a polygon with a bay into triangles that
    overlap.
    """
    numbers: list[float] = []
    polygons: list[list[int]] = []
    for line in io.StringIO(content.decode(errors="replace").replace("\\\n", " "), None):
        key, *words = line.partition("#")[0].split() or [""]
        if key == "v":
            x, y, z = map(float, words[:3])
            numbers += (x, y, z)
        elif key == "f":
            corners = [int(word.partition("/")[0]) for word in words]
            count = len(numbers) // 3
            polygons.append([index + count if index < 0 else index - 1 for index in corners])
    vertices = np.array(numbers).reshape(-1, 3)
    faces = [face for polygon in polygons for face in _triangles(polygon, vertices)]
    return vertices, np.array(faces, dtype=np.int64).reshape(-1, 3)


def _triangles(polygon: list[int], vertices: Points) -> list[list[int]]:
    """Cut a polygon of vertices into triangles, in the plane that it nearly lies in."""
    if len(polygon) > 3:
        points = vertices.take(polygon, axis=0, mode="clip")  # a wrong index is refused later
        normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
        axis = int(np.abs(normal).argmax())
        kept = ((axis + 1) % 3, (axis + 2) % 3)[:: 1 if normal[axis] > 0.0 else -1]
        cut = manifold3d.triangulate([np.ascontiguousarray(points[:, kept])])
        if len(cut) == len(polygon) - 2:
            return [[polygon[corner] for corner in face] for face in cut.tolist()]
    return [[polygon[0], *polygon[i : i + 2]] for i in range(1, len(polygon) - 1)]


def _merged(vertices: Points) -> tuple[Points, Any]:
    """Return each vertex once, and the place of every given vertex among them.

    Vertices are one where each coordinate is, and coordinates are where they are next to each
    other: rounding would part some that differ by the last bit.
    """
    reach = SAME_VERTEX * float(np.ptp(vertices, axis=0).max())
    ranks = np.empty(vertices.shape, np.int64)
    for axis, values in enumerate(vertices.T):
        order = np.argsort(values)
        ranks[order, axis] = np.cumsum(np.diff(values[order], prepend=-np.inf) > reach)
    _, first, place = np.unique(ranks, axis=0, return_index=True, return_inverse=True)
    return vertices[first], place.reshape(-1)


def _read_urdf(path: Path) -> Mesh:
    """Return the collision meshes of a URDF of one link as one, in the link's frame.

    Raises:
        UnreadableError: it is not a URDF of a single link made of meshes.
    """
    links = _urdf_root(path).findall("link")
    if len(links) != 1:
        raise UnreadableError(f"a URDF of {len(links)} links, not one")
    kind = "visual" if links[0].find("collision/geometry/mesh") is None else "collision"
    points, faces, size = [], [], 0
    for element in links[0].findall(kind):
        mesh, origin = element.find("geometry/mesh"), element.find("origin")
        if mesh is None:
            raise UnreadableError("a geometry of the URDF is not a mesh")
        if not math.prod(scale := _three(mesh, "scale", "1 1 1")):
            raise UnreadableError("the URDF's scale is 0")
        placed: Points = trimesh.transformations.compose_matrix(  # type: ignore[no-untyped-call]
            scale=scale,
            angles=_three(origin, "rpy", "0 0 0"),
            translate=_three(origin, "xyz", "0 0 0"),
        )
        try:
            file = _named_file(path, mesh)
            size += os.path.getsize(file) if os.path.isfile(file) else 0
            if size > MOST_BYTES:
                raise UnreadableError(f"with it the meshes have more than {MOST_BYTES // MIB} MiB")
            read = _read_mesh(file)
        except UnreadableError as error:
            raise UnreadableError(f"its mesh '{mesh.get('filename', '')}': {error}") from error
        points.append(trimesh.transform_points(read.vertices, placed))
        faces.append(read.faces[:, :: -1 if math.prod(scale) < 0.0 else 1])  # mirrored
    if not points:
        raise UnreadableError("the URDF names no mesh")
    joined: Any = trimesh.util.append_faces(points, faces)
    if not np.isfinite(joined[0]).all():
        raise UnreadableError(Reason.NOT_FINITE)
    if len(joined[1]) > MOST_FACES:
        raise UnreadableError(f"more than {MOST_FACES} faces ({len(joined[1])})")
    return Mesh(joined[0], joined[1].astype(np.int32))


def _urdf_root(path: Path) -> ElementTree.Element:
    text = _read(path, MIB).decode(errors="replace")
    try:
        if re.search(r"<!(DOCTYPE|ENTITY)", text):
            raise ElementTree.ParseError("entities are not read")
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise UnreadableError("no readable .urdf file") from error


def _files_of_urdf(path: Path) -> Iterator[Path]:
    """Yield the mesh files that a URDF names, as far as it can be read."""
    with suppress(UnreadableError):
        for mesh in _urdf_root(path).iter("mesh"):
            with suppress(UnreadableError):
                if (file := _named_file(path, mesh)).suffix.lower() in MESHES:
                    yield file


def _named_file(path: Path, mesh: ElementTree.Element) -> Path:
    """Return the file that a URDF names, beside it or in a ROS package that it is part of.

    Raises:
        UnreadableError: it is in a package of which no folder is found, or on the web.
    """
    name = mesh.get("filename", "").removeprefix("file://")
    scheme, is_address, inside = name.partition("://")
    if not is_address:
        return path.parent / name
    if scheme == "package":
        for folder in path.absolute().parents:
            if os.path.isfile(folder / inside):
                return folder / inside
    raise UnreadableError("not found in a folder above the URDF")


def _three(element: ElementTree.Element | None, key: str, default: str) -> tuple[float, ...]:
    text = default if element is None else element.get(key, default)
    try:
        x, y, z = (float(part) for part in text.split())
    except ValueError as error:
        raise UnreadableError(f"the URDF's {key} is not three numbers") from error
    return x, y, z
