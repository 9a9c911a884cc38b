"""A shape's bytes: geometry in whole steps of 2 µm, mass, inertia. Same bytes, same shape.

Layout, little-endian: magic ``MTS1``; float64 mass (kg) and three principal moments (kg m²);
uint16 visual vertices, faces, hulls; int16 (V, 3) and uint16 (F, 3); then for each hull
uint16 vertices and faces, int16 (v, 3), uint8 (f, 3).
"""

import hashlib
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from minitouch_bench.errors import UsageError
from minitouch_bench.shapegen.geometry import Mesh, Points

STEP = 2e-6
"""Size of one step of a stored coordinate, in m: exact in the six decimals of an OBJ file."""
LIMIT = 32_767
MAGIC = b"MTS1"
_HEAD = struct.Struct("<4s4d3H")
_HULL = struct.Struct("<2H")

URDF = Path(__file__).with_name("shape.urdf").read_text("utf-8")
"""A link whose frame is the inertial frame: no offset, a diagonal tensor. PyBullet multiplies its
lateral friction by the other body's."""
CODEC = "v1"
"""Version of these texts: part of the file names, since PyBullet caches meshes by name."""


@dataclass(frozen=True)
class Body:
    """A rigid body in its own frame: origin at the center of mass, axes the principal ones.

    ``visual`` is the closed surface, ``hulls`` its convex parts, ``mass`` in kg, ``inertia``
    the three principal moments in kg m².
    """

    visual: Mesh
    hulls: tuple[Mesh, ...]
    mass: float
    inertia: tuple[float, float, float]


def quantized(vertices: Points) -> Points:
    """Round vertices to the stored grid.

    Raises:
        ValueError: a coordinate is not finite, or farther than 65 mm from the origin.
    """
    steps = np.rint(vertices / STEP)
    if not np.all(np.abs(steps) <= LIMIT):  # false for NaN too
        raise ValueError("a vertex is not finite or farther than 65 mm from the center of mass")
    # Dividing by a whole number gives the double nearest to the decimal in the file.
    # Adding zero makes -0.0 plain 0.0, which alone survives the record.
    return steps / 500_000.0 + 0.0


def encode(body: Body) -> bytes:
    """Return the record of a body whose vertices are on the grid."""
    head = _HEAD.pack(
        MAGIC, body.mass, *body.inertia,
        len(body.visual.vertices), len(body.visual.faces), len(body.hulls),
    )  # fmt: skip
    parts = [head, _steps(body.visual), body.visual.faces.astype("<u2").tobytes()]
    for hull in body.hulls:
        parts += [
            _HULL.pack(len(hull.vertices), len(hull.faces)),
            _steps(hull),
            hull.faces.astype(np.uint8).tobytes(),
        ]
    return b"".join(parts)


def decode(record: bytes) -> Body:
    """Return the body a record holds.

    Raises:
        UsageError: the bytes are not a record, too short, too long or inconsistent.
    """
    try:
        magic, mass, ixx, iyy, izz, vertices, faces, count = _HEAD.unpack_from(record)
        if magic != MAGIC:
            raise ValueError("not a shape record")
        visual, at = _read_mesh(record, _HEAD.size, (vertices, faces), "<u2")
        hulls = []
        for _ in range(count):
            sizes = _HULL.unpack_from(record, at)
            hull, at = _read_mesh(record, at + _HULL.size, sizes, "u1")
            hulls.append(hull)
        if at != len(record):
            raise ValueError("bytes left over")
    except (ValueError, struct.error) as error:
        raise UsageError(f"the shape's record is damaged: {error}") from error
    return Body(visual, tuple(hulls), mass, (ixx, iyy, izz))


def digest(*parts: bytes) -> str:
    """Return the SHA-256 of a record, or of a body's files one after another, in hex."""
    return hashlib.sha256(b"".join(parts)).hexdigest()


def _steps(mesh: Mesh) -> bytes:
    return np.rint(mesh.vertices / STEP).astype("<i2").tobytes()


def _read_mesh(record: bytes, at: int, sizes: tuple[int, int], index_type: str) -> tuple[Mesh, int]:
    """Return the mesh that begins at a byte, and the byte after it."""
    steps = np.frombuffer(record, "<i2", 3 * sizes[0], at).reshape(-1, 3)
    at += steps.nbytes
    faces = np.frombuffer(record, index_type, 3 * sizes[1], at).reshape(-1, 3)
    if faces.size and int(faces.max()) >= sizes[0]:
        raise ValueError("a face names a vertex that is not there")
    mesh = Mesh(steps.astype(np.float64) / 500_000.0, faces.astype(np.int32))
    return mesh, at + faces.nbytes


def body_files(body: Body, stem: str = "") -> dict[str, bytes]:
    """Return the bytes of a body's two OBJ files and its URDF by name, in alphabetic order.

    Equal bodies give equal bytes, if ``stem``, with which the names begin, is equal or left out.
    """
    stem = stem or f"{digest(encode(body))[:20]}-{CODEC}"
    collision, visual, urdf = f"{stem}-collision.obj", f"{stem}-visual.obj", f"{stem}.urdf"
    ixx, iyy, izz = body.inertia
    text = URDF.format(
        mass=body.mass, ixx=ixx, iyy=iyy, izz=izz, visual=visual, collision=collision
    )
    return {
        collision: obj_text(body.hulls).encode(),
        visual: obj_text((body.visual,)).encode(),
        urdf: text.encode(),
    }


def obj_text(meshes: tuple[Mesh, ...]) -> str:
    """Return an OBJ of one object per mesh; coordinates in m, exact on the 2 µm grid."""
    lines, first = [], 1
    for number, mesh in enumerate(meshes):
        lines.append(f"o part{number}")
        lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + first).tolist()]
        first += len(mesh.vertices)
    return "\n".join(lines) + "\n"
