"""Interim shapes until the canonical set lands."""

import itertools
from collections.abc import Sequence

import numpy as np

from minitouch_bench.cache import materialise
from minitouch_bench.tasks.objects import ObjectModel, ObjectPool

SIZES = {
    "box-a": (0.045, 0.045, 0.045),
    "box-b": (0.06, 0.035, 0.03),
    "box-c": (0.05, 0.05, 0.03),
    "cyl-a": (0.02, 0.05),
    "cyl-b": (0.026, 0.06),
    "cyl-c": (0.03, 0.04),
}


def _load(name: str) -> ObjectModel:
    s = SIZES[name]
    m = 0.15
    if len(s) == 3:
        g = f'<box size="{s[0]} {s[1]} {s[2]}"/>'
        v = np.array(list(itertools.product(*[(-x / 2, x / 2) for x in s])))
        I = [
            m * (s[1] ** 2 + s[2] ** 2) / 12,
            m * (s[0] ** 2 + s[2] ** 2) / 12,
            m * (s[0] ** 2 + s[1] ** 2) / 12,
        ]
    else:
        g = f'<cylinder radius="{s[0]}" length="{s[1]}"/>'
        a = np.linspace(0, 2 * np.pi, 48)
        v = np.concatenate(
            [
                np.stack([s[0] * np.cos(a), s[0] * np.sin(a), 0 * a + z], 1)
                for z in (-s[1] / 2, s[1] / 2)
            ]
        )
        I = [m * (3 * s[0] ** 2 + s[1] ** 2) / 12] * 2 + [m * s[0] ** 2 / 2]
    urdf = f'<robot name="{name}"><link name="o"><contact><lateral_friction value="1.0"/></contact><inertial><mass value="{m}"/><inertia ixx="{I[0]}" ixy="0" ixz="0" iyy="{I[1]}" iyz="0" izz="{I[2]}"/></inertial><visual><geometry>{g}</geometry><material name="p"><color rgba="0.8 0.4 0.2 1"/></material></visual><collision><geometry>{g}</geometry></collision></link></robot>'
    return ObjectModel(
        name, materialise(name, ".urdf", urdf.encode()), (0.0, 0.0, 0.0, 1.0), -v[:, 2].min(), v
    )


def shape_pool(chosen: str | Sequence[str]) -> ObjectPool:
    return ObjectPool(tuple(SIZES), _load)
