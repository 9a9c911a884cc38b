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
    moment = cube.mass * cube.side**2 / 6
    boxes = _boxes([((0, 0, 0), (cube.side,) * 3)], COLORS.object_color)
    return _filled("cube", cube=cube, inertia=_inertia(moment, moment, moment), boxes=boxes)


@cache
def cabinet_urdf(c: CabinetSpec) -> Path:
    """Return the URDF of a cabinet."""
    handle_height = c.handle_high - c.handle_low
    handle = (c.handle_thickness, c.handle_thickness, handle_height)
    door = (c.door_thickness, c.door_width, c.door_height)
    door_middle = (0.0, c.door_width / 2 - c.door_overhang, c.height / 2)
    return _filled(
        "cabinet",
        c=c,
        body=_boxes(_body_boxes(c), COLORS.cabinet_color),
        door=_boxes([(door_middle, door)], COLORS.door_color),
        handle=_boxes([((0, 0, 0), handle)], COLORS.handle_color),
        door_middle=_text(door_middle),
        hinge_x=c.door_thickness / 2,
        handle_x=-(c.door_thickness + c.handle_thickness) / 2,
        handle_z=c.handle_low + handle_height / 2,
        no_inertia=_inertia(0, 0, 0),
        handle_inertia=_inertia(1e-5, 1e-5, 1e-5),
        door_inertia=_inertia(
            c.door_mass * (c.door_height**2 + c.door_width**2) / 12,
            c.door_mass * (c.door_height**2 + c.door_thickness**2) / 12,
            c.door_mass * (c.door_width**2 + c.door_thickness**2) / 12,
        ),
    )


def _filled(name: str, **values: object) -> Path:
    """Return a file of the template ``name`` with these values in it."""
    template = Path(__file__).with_name(f"{name}.urdf").read_text("utf-8")
    return cache_file(name, ".urdf", template.format(**values).encode())


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
