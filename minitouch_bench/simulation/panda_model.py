"""A light Panda: the joints of ``pybullet_data``'s, with meshes of far fewer triangles.

The software renderer's cost grows with triangles: the stock visual meshes hold about 100,000,
these about 900. Loading a world costs by vertices of the collision hulls: the hand and the
fingers keep the stock ones, the other links have the light meshes. ``benchmarks.panda_meshes``
makes the files in ``panda/`` from the installed package.
"""

import xml.etree.ElementTree as ET
from functools import cache
from pathlib import Path

import pybullet_data

from minitouch_bench.cache import cache_file
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import Rgba

MESHES = Path(__file__).parent / "panda"
LINK_COLORS = {"panda_hand": PROTOCOL.observation.hand_color}


def stock_panda() -> Path:
    """Return the URDF of the full Panda in ``pybullet_data``."""
    return Path(pybullet_data.getDataPath()) / "franka_panda/panda.urdf"


@cache
def light_panda() -> Path:
    """Return the URDF of the light Panda, as the protocol wants it."""
    physics, observation = PROTOCOL.physics, PROTOCOL.observation
    root = ET.parse(stock_panda()).getroot()
    for link in root.iter("link"):
        for kind in ("visual", "collision"):
            for mesh in link.iterfind(f"{kind}/geometry/mesh"):
                stem = Path(mesh.attrib["filename"]).stem
                whole = kind == "collision" and stem == "hand"
                mesh.set("filename", str(MESHES / f"{stem}-{'stock' if whole else 'light'}.obj"))
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
            color = LINK_COLORS.get(name, observation.arm_color)
            ET.SubElement(material, "color", rgba=rgba_text(color))
    return cache_file("panda", ".urdf", ET.tostring(root))


def rgba_text(color: Rgba) -> str:
    """Return a color as URDF writes it."""
    return " ".join(str(part) for part in color)
