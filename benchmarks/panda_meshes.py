"""Make the Panda in ``minitouch_bench/simulation/``, URDF and meshes, from ``pybullet_data``'s.

``python -m benchmarks.panda_meshes [DIRECTORY]``; the committed files in ``panda/`` and
``portrait/`` are what it writes.
"""

import sys
import xml.etree.ElementTree as ET
from copy import deepcopy
from pathlib import Path

import fast_simplification
import numpy as np
import pybullet_data
import trimesh
from PIL import Image

from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.simulation.bodies import PANDA, PORTRAIT_PANDA

LIGHT_TRIANGLES = 90
"""Triangles kept of each link; at 84 x 84 pixels more cannot be told apart."""

PORTRAIT_SHARE, PORTRAIT_LEAST = 0.09, 100
"""Share of each part's triangles kept for pictures of 240 x 240 pixels, and the least number."""

PORTRAIT_COLORS = {"white": "1 1 1 1", "dark": "0.4 0.4 0.43 1"}

STOCK = Path(pybullet_data.getDataPath()) / "franka_panda"

ORIGIN = (
    " The Panda of pybullet_data (franka_panda, Apache License 2.0); meshes, colors and finger "
    "contact were changed by benchmarks/panda_meshes.py "
)
"""What both URDFs say of themselves: the license asks for it."""

SIDE, DARK_BELOW = 1024, 200
"""Of the palette: the pixels of a side, and the gray level below which a part is dark."""


def write_panda(directory: Path) -> None:
    """Write the light meshes of all links, the hand's hull as installed, and the URDF."""
    directory.mkdir(parents=True, exist_ok=True)
    for source in sorted((STOCK / "meshes" / "collision").glob("*.obj")):
        mesh = trimesh.load_mesh(source)
        # The simplifier tears holes between vertices that differ in nothing but their normal.
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        if source.stem == "hand":
            _write(directory / "hand-stock.obj", vertices, faces)
        light = simplify(vertices, faces, LIGHT_TRIANGLES)
        _write(directory / f"{source.stem}-light.obj", *light)
    physics, observation = PROTOCOL.physics, PROTOCOL.observation
    root = ET.parse(STOCK / "panda.urdf").getroot()
    for link in root.iter("link"):
        for kind in ("visual", "collision"):
            for mesh in link.iterfind(f"{kind}/geometry/mesh"):
                stem = Path(mesh.attrib["filename"]).stem
                whole = kind == "collision" and stem == "hand"
                mesh.set("filename", f"{stem}-{'stock' if whole else 'light'}.obj")
                if kind == "visual" and stem == "hand":
                    mesh.set("scale", f"1 {observation.hand_drawn_width} 1")
        for stiffness in link.iterfind("contact/stiffness"):
            stiffness.set("value", str(physics.finger_stiffness))
        for damping in link.iterfind("contact/damping"):
            damping.set("value", str(physics.finger_damping))
        for material in link.iterfind("visual/material"):
            name = link.attrib["name"]
            material.clear()
            material.set("name", f"{name}_paint")
            color = observation.hand_color if name == "panda_hand" else observation.arm_color
            ET.SubElement(material, "color", rgba=" ".join(map(repr, color)))
    root.insert(0, ET.Comment(ORIGIN))
    (directory / PANDA.name).write_bytes(ET.tostring(root))


def write_portrait(directory: Path) -> None:
    """Write the white and the dark parts of all links, for pictures, and their URDF."""
    directory.mkdir(parents=True, exist_ok=True)
    meshes = STOCK / "meshes"
    shared = [meshes / "collision" / f"{link}.obj" for link in ("link0", "link7")]
    for source in (*shared, *(meshes / "visual").glob("*.obj")):
        for tone, mesh in tones(source).items():
            file = directory / f"{source.stem}-{tone}.obj"
            _write(file, mesh.vertices, mesh.faces, mesh.vertex_normals)
    root = ET.parse(STOCK / "panda.urdf").getroot()
    for link in root.iter("link"):
        for collision in link.findall("collision"):
            link.remove(collision)
        for whole in link.findall("visual"):
            link.remove(whole)
            stem = Path(next(whole.iter("mesh")).attrib["filename"]).stem
            for color, rgba in PORTRAIT_COLORS.items():
                if (directory / f"{stem}-{color}.obj").exists():
                    part = deepcopy(whole)
                    part.remove(next(part.iter("material")))
                    next(part.iter("mesh")).set("filename", f"{stem}-{color}.obj")
                    material = ET.SubElement(part, "material", name=color)
                    ET.SubElement(material, "color", rgba=rgba)
                    link.append(part)
    root.insert(0, ET.Comment(ORIGIN))
    (directory / PORTRAIT_PANDA.name).write_bytes(ET.tostring(root))


def tones(source: Path) -> dict[str, trimesh.Trimesh]:
    """Return the white and the dark parts of a mesh, simplified; its texture is a palette."""
    parts: dict[str, list[trimesh.Trimesh]] = {}
    palette = np.asarray(Image.open(source.parents[1] / "visual" / "colors.png").convert("L"))
    for mesh in trimesh.load_scene(source, group_material=True).geometry.values():
        tone = "white"
        uv = getattr(mesh.visual, "uv", None)
        if uv is not None:
            u, v = (SIDE * uv).astype(int).clip(0, SIDE - 1).T
            tone = "dark" if palette[SIDE - 1 - v, u].mean() < DARK_BELOW else "white"
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        triangles = max(PORTRAIT_LEAST, round(PORTRAIT_SHARE * len(mesh.faces)))
        light = trimesh.Trimesh(*simplify(mesh.vertices, mesh.faces, triangles), process=False)
        parts.setdefault(tone, []).append(light)
    return {tone: trimesh.util.concatenate(meshes) for tone, meshes in parts.items()}


def simplify(
    vertices: np.ndarray, faces: np.ndarray, triangles: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return a mesh of at most so many triangles."""
    if len(faces) <= triangles:
        return vertices, faces
    # The simplifier stalls on coordinates in meters; in centimeters it does not.
    vertices, faces = fast_simplification.simplify(
        vertices * 100.0, faces, target_count=triangles, agg=7
    )
    return vertices / 100.0, faces


def _write(
    path: Path, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray | None = None
) -> None:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    if normals is not None:
        lines += [f"vn {x:.3f} {y:.3f} {z:.3f}" for x, y, z in normals]
        lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in faces + 1]
    else:
        lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


if __name__ == "__main__":
    write_panda(Path(sys.argv[1]) if len(sys.argv) > 1 else PANDA.parent)
    write_portrait(Path(sys.argv[1]) if len(sys.argv) > 1 else PORTRAIT_PANDA.parent)
