"""A light copy of the Panda that ``pybullet_data`` installs, made on first use.

The software renderer's cost grows with triangles: the stock visual meshes hold about
100,000, this copy about 900. Loading a world costs by vertices of the collision hulls: the
hand and the fingers, which touch things, keep the stock ones; the arm's links, which meet
nothing in any task, take the light meshes.
"""

import shutil
import tempfile
import xml.etree.ElementTree as ET
from functools import cache
from pathlib import Path

import fast_simplification
import numpy as np
import trimesh

from minitouch_bench.cache import cache_directory, cache_errors, content_digest
from minitouch_bench.simulation.installed import data_directory

LIGHT_TRIANGLES = 90
"""Triangles kept of each link; at 84 x 84 pixels more cannot be told apart."""

HAND_DRAWN_WIDTH = 0.4
"""The hand is drawn narrower than it is: whole, it would hide the fingers from the camera."""

TOUCHING_MESHES = ("hand", "finger")

FINGER_STIFFNESS = 300_000.0

WHITE = "0.93 0.93 0.95 1"
DARK = "0.30 0.32 0.36 1"
LINK_COLORS = {"panda_hand": DARK}


def stock_panda() -> Path:
    """Return the URDF of the full Panda in ``pybullet_data``."""
    return data_directory() / "franka_panda" / "panda.urdf"


@cache
def light_panda() -> Path:
    """Return the URDF of the light Panda, building its files if they are not there."""
    source = stock_panda()
    meshes = sorted((source.parent / "meshes" / "collision").glob("*.obj"))
    digest = content_digest([source, *meshes, Path(__file__)])
    directory = cache_directory() / f"panda-{digest}"
    if not (directory / "panda.urdf").is_file():
        _build(source, meshes, directory)
    return directory / "panda.urdf"


def _build(source: Path, meshes: list[Path], directory: Path) -> None:
    """Write all files beside the final place, then move them there at once."""
    with cache_errors(directory.parent):
        directory.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(dir=directory.parent))
        try:
            for mesh in meshes:
                _write_meshes(mesh, staging)
            (staging / "panda.urdf").write_text(_urdf(source), encoding="utf-8")
            staging.replace(directory)
        except OSError:
            # Another process may have been first; its files are the same.
            if not (directory / "panda.urdf").is_file():
                raise
        finally:
            shutil.rmtree(staging, ignore_errors=True)


def _write_meshes(source: Path, directory: Path) -> None:
    mesh = trimesh.load_mesh(source)
    # The simplifier tears holes between vertices that differ in nothing but their normal.
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    _write_obj(directory / f"{source.stem}-stock.obj", vertices, faces)
    if len(faces) > LIGHT_TRIANGLES:
        # The simplifier stalls on coordinates in metres; in centimetres it does not.
        vertices, faces = fast_simplification.simplify(
            vertices * 100.0, faces, target_count=LIGHT_TRIANGLES, agg=7
        )
        vertices = vertices / 100.0
    _write_obj(directory / f"{source.stem}-light.obj", vertices, faces)


def _write_obj(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _urdf(source: Path) -> str:
    tree = ET.parse(source)
    for link in tree.getroot().iter("link"):
        for kind in ("visual", "collision"):
            for mesh in link.iterfind(f"{kind}/geometry/mesh"):
                stem = Path(mesh.attrib["filename"]).stem
                stock = kind == "collision" and stem in TOUCHING_MESHES
                mesh.set("filename", f"{stem}-{'stock' if stock else 'light'}.obj")
                if kind == "visual" and stem == "hand":
                    mesh.set("scale", f"1 {HAND_DRAWN_WIDTH} 1")
        for stiffness in link.iterfind("contact/stiffness"):
            stiffness.set("value", str(FINGER_STIFFNESS))
        for material in link.iterfind("visual/material"):
            name = link.attrib["name"]
            material.clear()
            material.set("name", f"{name}_paint")
            ET.SubElement(material, "color", rgba=LINK_COLORS.get(name, WHITE))
    return ET.tostring(tree.getroot(), encoding="unicode")
