"""Star-shaped bodies: a sphere whose radius is a sum of low spherical waves, then stretched."""

import numpy as np

from minitouch_bench.shapegen.mesh import Points
from minitouch_bench.shapegen.solids import Solid


def harmonic(rng: np.random.Generator) -> Solid:
    """Return a pebble, a lobed blob or a many-sided star body."""
    waves = int(rng.integers(3, 8))
    strength = rng.uniform(0.10, 0.34)
    axes = rng.normal(size=(waves, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    orders = rng.integers(2, 6, size=waves)
    phases = rng.uniform(0.0, 2.0 * np.pi, size=waves)
    weights = rng.normal(size=waves)
    weights *= strength / np.abs(weights).sum() * np.sqrt(waves)
    stretch = np.array([1.0, rng.uniform(0.55, 0.95), rng.uniform(0.45, 0.85)])
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))

    def deform(points: Points) -> Points:
        directions = points / np.linalg.norm(points, axis=1, keepdims=True)
        angles = np.arccos(np.clip(directions @ axes.T, -1.0, 1.0))
        radius = 1.0 + (weights * np.cos(orders * angles + phases)).sum(axis=1)
        stretched: Points = (np.maximum(radius, 0.4)[:, None] * directions @ rotation) * stretch
        return stretched

    return Solid.sphere(1.0, 48).warp_batch(deform)
