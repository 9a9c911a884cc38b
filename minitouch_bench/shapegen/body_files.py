"""A body as the files simulators read: one URDF, one OBJ to see, one OBJ of hulls to touch."""

import hashlib
from dataclasses import dataclass

from minitouch_bench.shapegen.mesh import Mesh
from minitouch_bench.shapegen.record import Body, digest, encode

FRICTION = 1.0
"""Lateral friction in the URDF: PyBullet multiplies it by the other body's."""
COLOR = "0.62 0.66 0.70 1"
FORMAT = "v1"
"""Version of these texts: part of the file names, since PyBullet caches meshes by name."""


@dataclass(frozen=True)
class BodyFiles:
    """File names without folder, and their bytes; the URDF names the two OBJ files."""

    urdf_name: str
    contents: dict[str, bytes]

    @property
    def sha256(self) -> str:
        """Hex digest over the bytes of the files in the order of their names."""
        sha = hashlib.sha256()
        for name in sorted(self.contents):
            sha.update(self.contents[name])
        return sha.hexdigest()


def file_names(record_digest: str) -> tuple[str, str, str]:
    """Return the names of the collision OBJ, the URDF and the visual OBJ."""
    stem = f"{record_digest[:20]}-{FORMAT}"
    return f"{stem}-collision.obj", f"{stem}.urdf", f"{stem}-visual.obj"


def body_files(body: Body) -> BodyFiles:
    """Write a body as texts; equal bodies give equal bytes."""
    collision, urdf, visual = file_names(digest(encode(body)))
    contents = {
        collision: obj_text(body.hulls).encode(),
        visual: obj_text((body.visual,)).encode(),
        urdf: urdf_text(body, visual, collision).encode(),
    }
    return BodyFiles(urdf, contents)


def obj_text(meshes: tuple[Mesh, ...]) -> str:
    """Return an OBJ of one object per mesh; coordinates in m, exact on the 2 µm grid."""
    lines, first = [], 1
    for number, mesh in enumerate(meshes):
        lines.append(f"o part{number}")
        lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + first).tolist()]
        first += len(mesh.vertices)
    return "\n".join(lines) + "\n"


def urdf_text(body: Body, visual: str, collision: str) -> str:
    """Return a URDF whose link frame is the inertial frame: no offset, a diagonal tensor."""
    ixx, iyy, izz = body.inertia
    return f"""<?xml version="1.0"?>
<robot name="shape">
  <link name="body">
    <contact>
      <lateral_friction value="{FRICTION}"/>
    </contact>
    <inertial>
      <origin xyz="0 0 0" rpy="0 0 0"/>
      <mass value="{body.mass!r}"/>
      <inertia ixx="{ixx!r}" ixy="0" ixz="0" iyy="{iyy!r}" iyz="0" izz="{izz!r}"/>
    </inertial>
    <visual>
      <origin xyz="0 0 0" rpy="0 0 0"/>
      <geometry><mesh filename="{visual}"/></geometry>
      <material name="grey"><color rgba="{COLOR}"/></material>
    </visual>
    <collision>
      <origin xyz="0 0 0" rpy="0 0 0"/>
      <geometry><mesh filename="{collision}"/></geometry>
    </collision>
  </link>
</robot>
"""
