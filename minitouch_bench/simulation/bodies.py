"""Bodies: the Panda's files, the cube, the cabinet with its door, and the table."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

from minitouch_bench.files import cache_file
from minitouch_bench.protocol.minitouch import PROTOCOL, CabinetSpec, CubeSpec
from minitouch_bench.protocol.spec import Rgba
from minitouch_bench.simulation.client import PhysicsClient

PANDA = Path(__file__).parent / "panda/panda.urdf"
"""The Panda of ``pybullet_data`` with meshes of far fewer triangles, as ``benchmarks.panda_meshes``
makes it with the protocol's colors and stiffness of the fingers.

The software renderer's cost grows with triangles: the stock visual meshes hold about 100,000,
these about 900. Loading a world costs by vertices of the collision hulls: the hand and the fingers
keep the stock ones, the other links have the light meshes."""

PORTRAIT_PANDA = Path(__file__).parent / "portrait/panda.urdf"
"""A Panda that is only looked at, which is not the protocol's: 8,000 triangles in two colors."""

Box = tuple[Sequence[float], Sequence[float]]
"""Center and full size (m) in the link's frame."""

COLORS = PROTOCOL.observation

DOOR_LINK = 0
HANDLE_LINK = 1
DOOR_JOINT = 0


@cache
def cube_urdf(cube: CubeSpec) -> Path:
    """Return the URDF of a cube."""
    side, mass = cube.side, cube.mass
    inertia = mass * side**2 / 6
    return cache_file(
        "cube",
        ".urdf",
        f"""<robot name="cube"><link name="cube">
  <contact><friction_anchor/><lateral_friction value="{cube.friction}"/></contact>
  <inertial><mass value="{mass}"/>{_inertia(inertia, inertia, inertia)}</inertial>
{_boxes([((0, 0, 0), (side, side, side))], COLORS.object_color)}
</link></robot>
""".encode(),
    )


@cache
def cabinet_urdf(cabinet: CabinetSpec) -> Path:
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
    return cache_file(
        "cabinet",
        ".urdf",
        f"""<robot name="cabinet">
<link name="body"><inertial><mass value="0"/>{_inertia(0, 0, 0)}</inertial>
{_boxes(_body_boxes(c), COLORS.cabinet_color)}
</link>
<link name="door"><inertial><origin xyz="{_text(door_middle)}"/><mass value="{c.door_mass}"/>
{_inertia(depth_inertia, tilt_inertia, swing_inertia)}</inertial>
{_boxes([(door_middle, door)], COLORS.door_color)}
</link>
<joint name="hinge" type="revolute"><parent link="body"/><child link="door"/>
  <origin xyz="{c.door_thickness / 2} {c.hinge_y} 0"/><axis xyz="0 0 1"/>
  <limit lower="0" upper="{c.max_angle}" effort="100" velocity="10"/>
</joint>
<link name="handle"><inertial><mass value="0.01"/>{_inertia(1e-5, 1e-5, 1e-5)}</inertial>
{_boxes([((0, 0, 0), handle)], COLORS.handle_color)}
</link>
<joint name="mount" type="fixed"><parent link="door"/><child link="handle"/>
  <origin xyz="{handle_x} {c.handle_radius} {handle_z}"/>
</joint>
</robot>
""".encode(),
    )


def _body_boxes(c: CabinetSpec) -> list[Box]:
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


def _boxes(boxes: Sequence[Box], color: Rgba) -> str:
    rgba = _text(color)
    paint = f'<material name="paint {rgba}"><color rgba="{rgba}"/></material>'
    places = [
        f'<origin xyz="{_text(center)}"/><geometry><box size="{_text(size)}"/></geometry>'
        for center, size in boxes
    ]
    visual = [f"<visual>{place}{paint}</visual>" for place in places]
    return "\n".join([*visual, *(f"<collision>{place}</collision>" for place in places)])


def _inertia(xx: float, yy: float, zz: float) -> str:
    return f'<inertia ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"/>'


def _text(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def add_table(client: PhysicsClient) -> int:
    """Add the table and return its id."""
    physics = PROTOCOL.physics
    half = physics.table_half_extents
    return client.add_box(
        half,
        (*physics.table_center, physics.table_top - half[2]),
        PROTOCOL.observation.table_color,
        friction=physics.table_friction,
    )
