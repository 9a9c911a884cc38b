"""Convex decomposition by CoACD, with settings measured for meshes of about 400 faces."""

from dataclasses import dataclass

import coacd
import numpy as np

from minitouch_bench.shapegen.mesh import Mesh
from minitouch_bench.shapegen.solids import to_mesh, to_solid


@dataclass(frozen=True)
class DecompositionConfig:
    """Settings of CoACD; ``threshold`` is its concavity bound, relative to the shape's size.

    ``longest_edge`` (m): longer edges are split first. On long thin triangles, such as those
    round a hole in a flat face, the search took 25 s and found worse hulls.
    """

    threshold: float = 0.1
    iterations: int = 20
    depth: int = 2
    max_hulls: int = 16
    max_hull_vertices: int = 64
    resolution: int = 1000
    longest_edge: float = 0.015
    seed: int = 0


def convex_parts(mesh: Mesh, config: DecompositionConfig) -> tuple[Mesh, ...]:
    """Cover a closed 2-manifold mesh with convex hulls.

    A fault inside CoACD can end the process: call it in a worker.
    """
    coacd.set_log_level("error")
    fine = to_mesh(to_solid(mesh).refine_to_length(config.longest_edge))
    parts = coacd.run_coacd(
        coacd.Mesh(fine.vertices, fine.faces),
        threshold=config.threshold,
        mcts_iterations=config.iterations,
        mcts_max_depth=config.depth,
        max_convex_hull=config.max_hulls,
        decimate=True,
        max_ch_vertex=config.max_hull_vertices,
        resolution=config.resolution,
        preprocess_mode="off",
        seed=config.seed,
    )
    return tuple(
        Mesh(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int32))
        for vertices, faces in parts
    )
