"""Write the shapes of a set as other programs read them: URDF, OBJ, GLB or MJCF."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import trimesh

from minitouch_bench.errors import InfrastructureError, UsageError
from minitouch_bench.files import os_errors_as, replace_file
from minitouch_bench.shapegen.manifest import ShapeSet
from minitouch_bench.shapegen.record import FRICTION, Body, body_files, obj_text

Writer = Callable[[Body, str], dict[str, bytes]]
"""From a body and its name to file names and their bytes."""


def export(shapes: ShapeSet, folder: Path, form: str, split: str | None = None) -> int:
    """Write every shape, or those of one split, into a folder; return the number of files.

    Raises:
        UsageError: the format or the split is unknown.
        InfrastructureError: the folder cannot be written.
    """
    if form not in WRITERS:
        raise UsageError(f"unknown format '{form}': {', '.join(WRITERS)}")
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


def _glb(body: Body, name: str) -> dict[str, bytes]:
    # glTF is y-up; the mesh keeps the body frame, as its extras say nothing of gravity.
    mesh = trimesh.Trimesh(body.visual.vertices, body.visual.faces, process=False)
    scene: Any = trimesh.Scene(mesh)
    return {f"{name}.glb": bytes(scene.export(file_type="glb"))}


def _mjcf(body: Body, name: str) -> dict[str, bytes]:
    """Return a MuJoCo model: one free body, its hulls to touch, its surface to see."""
    files = {f"{name}-visual.obj": obj_text((body.visual,)).encode()}
    assets = [f'    <mesh name="visual" file="{name}-visual.obj"/>']
    geoms = ['      <geom type="mesh" mesh="visual" contype="0" conaffinity="0" group="1"/>']
    for number, hull in enumerate(body.hulls):
        files[f"{name}-hull{number}.obj"] = obj_text((hull,)).encode()
        assets.append(f'    <mesh name="hull{number}" file="{name}-hull{number}.obj"/>')
        geoms.append(
            f'      <geom type="mesh" mesh="hull{number}" group="3" friction="{FRICTION}"/>'
        )
    inertia = " ".join(repr(moment) for moment in body.inertia)
    asset, geom = "\n".join(assets), "\n".join(geoms)
    model = f"""<mujoco model="{name}">
  <compiler inertiafromgeom="false"/>
  <asset>
{asset}
  </asset>
  <worldbody>
    <body name="{name}">
      <freejoint/>
      <inertial pos="0 0 0" mass="{body.mass!r}" diaginertia="{inertia}"/>
{geom}
    </body>
  </worldbody>
</mujoco>
"""
    return {**files, f"{name}.xml": model.encode()}


WRITERS: Mapping[str, Writer] = MappingProxyType(
    {"urdf": body_files, "obj": _obj, "glb": _glb, "mjcf": _mjcf}
)
"""Every export format by name."""
