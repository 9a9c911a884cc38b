"""Bodies of our own making, as URDF text: the cube and the cabinet with its hinged door."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from minitouch_bench.cache import materialise

Box = tuple[Sequence[float], Sequence[float]]
"""Centre and full size (m) in the link's frame."""

BODY_COLOR = "0.30 0.31 0.33 1"
DOOR_COLOR = "0.40 0.38 0.36 1"
HANDLE_COLOR = "0.92 0.92 0.92 1"
CUBE_COLOR = "0.30 0.12 0.10 1"


@cache
def cube(side: float, mass: float, friction: float) -> Path:
    """Return the URDF of a cube (m, kg)."""
    inertia = mass * side**2 / 6
    return materialise(
        "cube",
        ".urdf",
        f"""<robot name="cube"><link name="cube">
  <contact><friction_anchor/><lateral_friction value="{friction}"/></contact>
  <inertial><mass value="{mass}"/>{_inertia(inertia, inertia, inertia)}</inertial>
{_boxes([((0, 0, 0), (side, side, side))], CUBE_COLOR)}
</link></robot>
""".encode(),
    )


@dataclass(frozen=True)
class Cabinet:
    """A cabinet with one hinged door, in metres, kilograms and newton metres.

    Its front (the door's outer face) is the plane x = 0 of its frame, facing the robot at
    negative x; its floor is z = 0 and its middle y = 0. Proportions measured off the
    released package's cabinet: the hinge's axis lies ``door_overhang`` inside the door's edge,
    the handle's middle ``handle_radius`` from the axis. The door is link 0, its handle link 1.
    """

    depth: float = 0.37
    width: float = 1.01
    height: float = 0.88
    wall: float = 0.02
    door_width: float = 0.497
    door_height: float = 0.835
    door_thickness: float = 0.021
    door_mass: float = 2.64
    hinge_y: float = -0.49
    hinge_friction: float = 0.496
    max_angle: float = 1.57
    door_overhang: float = 0.007
    handle_radius: float = 0.455
    handle_thickness: float = 0.026
    handle_low: float = 0.03
    handle_high: float = 0.85

    def handle_place(self, front: float, middle: float, angle: float) -> tuple[float, float]:
        """Return x, y (m) of the handle's middle with the door at ``angle`` (rad)."""
        outward = self.door_thickness / 2 + self.handle_thickness / 2
        hinge_x, hinge_y = front + self.door_thickness / 2, middle + self.hinge_y
        sine, cosine = math.sin(angle), math.cos(angle)
        x = hinge_x - self.handle_radius * sine - outward * cosine
        y = hinge_y + self.handle_radius * cosine - outward * sine
        return x, y


DOOR_LINK = 0
HANDLE_LINK = 1
DOOR_JOINT = 0


@cache
def cabinet_urdf(cabinet: Cabinet) -> Path:
    """Return the URDF of a cabinet."""
    c = cabinet
    handle_height = c.handle_high - c.handle_low
    handle = (c.handle_thickness, c.handle_thickness, handle_height)
    door = (c.door_thickness, c.door_width, c.door_height)
    depth_inertia = c.door_mass * (c.door_height**2 + c.door_width**2) / 12
    swing_inertia = c.door_mass * (c.door_width**2 + c.door_thickness**2) / 12
    tilt_inertia = c.door_mass * (c.door_height**2 + c.door_thickness**2) / 12
    door_middle = (0.0, c.door_width / 2 - c.door_overhang, c.height / 2)
    handle_x = -(c.door_thickness + c.handle_thickness) / 2
    handle_z = c.handle_low + handle_height / 2
    return materialise(
        "cabinet",
        ".urdf",
        f"""<robot name="cabinet">
<link name="body"><inertial><mass value="0"/>{_inertia(0, 0, 0)}</inertial>
{_boxes(_body_boxes(c), BODY_COLOR)}
</link>
<link name="door"><inertial><origin xyz="{_text(door_middle)}"/><mass value="{c.door_mass}"/>
{_inertia(depth_inertia, tilt_inertia, swing_inertia)}</inertial>
{_boxes([(door_middle, door)], DOOR_COLOR)}
</link>
<joint name="hinge" type="revolute"><parent link="body"/><child link="door"/>
  <origin xyz="{c.door_thickness / 2} {c.hinge_y} 0"/><axis xyz="0 0 1"/>
  <limit lower="0" upper="{c.max_angle}" effort="100" velocity="10"/>
</joint>
<link name="handle"><inertial><mass value="0.01"/>{_inertia(1e-5, 1e-5, 1e-5)}</inertial>
{_boxes([((0, 0, 0), handle)], HANDLE_COLOR)}
</link>
<joint name="mount" type="fixed"><parent link="door"/><child link="handle"/>
  <origin xyz="{handle_x} {c.handle_radius} {handle_z}"/>
</joint>
</robot>
""".encode(),
    )


def _body_boxes(c: Cabinet) -> list[Box]:
    """Walls; the half beside the door stays open, as in the released cabinet."""
    gap = 0.002
    inner = c.depth - c.door_thickness - gap
    x = c.door_thickness + gap + inner / 2
    side = (c.width - c.wall) / 2
    return [
        ((x, side, c.height / 2), (inner, c.wall, c.height)),
        ((x, -side, c.height / 2), (inner, c.wall, c.height)),
        ((x, 0.0, c.wall / 2), (inner, c.width, c.wall)),
        ((x, 0.0, c.height - c.wall / 2), (inner, c.width, c.wall)),
        ((c.depth - c.wall / 2, 0.0, c.height / 2), (c.wall, c.width, c.height)),
    ]


def _boxes(boxes: Sequence[Box], color: str) -> str:
    parts = []
    for kind in ("visual", "collision"):
        paint = (
            f'<material name="paint {color}"><color rgba="{color}"/></material>'
            if kind == "visual"
            else ""
        )
        parts += [
            f'<{kind}><origin xyz="{_text(center)}"/>'
            f'<geometry><box size="{_text(size)}"/></geometry>{paint}</{kind}>'
            for center, size in boxes
        ]
    return "\n".join(parts)


def _inertia(xx: float, yy: float, zz: float) -> str:
    return f'<inertia ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"/>'


def _text(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
