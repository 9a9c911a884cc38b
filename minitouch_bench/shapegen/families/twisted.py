"""Columns on random outlines: twisted, tapered, bent or bulged along their length."""

import numpy as np

from minitouch_bench.shapegen.families.outlines import random_outline
from minitouch_bench.shapegen.mesh import Points
from minitouch_bench.shapegen.solids import Solid


def twisted(rng: np.random.Generator) -> Solid:
    """Return a column that turns, narrows, leans or swells from its foot to its head."""
    height = float(rng.uniform(1.8, 3.6))
    twist = float(rng.uniform(15.0, 95.0) * rng.choice([-1, 1]))
    top = float(rng.uniform(0.45, 1.0))
    column = Solid.extrude(random_outline(rng), height, 24, twist, (top, top))
    bulge = float(rng.uniform(-0.25, 0.4))
    bend = float(rng.choice([0.0, rng.uniform(0.15, 0.6)])) / height

    def deform(points: Points) -> Points:
        share = points[:, 2] / height
        swell = 1.0 + bulge * np.sin(np.pi * share)
        x, y = points[:, 0] * swell, points[:, 1] * swell
        if bend > 0.0:
            radius = 1.0 / bend
            angle = points[:, 2] * bend
            return np.stack(
                [radius - (radius - x) * np.cos(angle), y, (radius - x) * np.sin(angle)], axis=1
            )
        return np.stack([x, y, points[:, 2]], axis=1)

    return column.warp_batch(deform)
