"""Make shape number i: draw, size, decompose, prove; the same shape in every process."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import coacd
import numpy as np

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.shapegen.body_codec import (
    Body,
    body_files,
    decode,
    digest,
    encode,
    files_digest,
    quantized,
)
from minitouch_bench.shapegen.families import FAMILIES
from minitouch_bench.shapegen.mesh import Mesh, in_body_frame, solid_moments
from minitouch_bench.shapegen.poses import RestPose
from minitouch_bench.shapegen.solids import Solid, hull_of, simplified, to_mesh, to_solid
from minitouch_bench.shapegen.soundness import (
    LIMITS,
    Measures,
    Reason,
    SoundnessConfig,
    UnsoundError,
    check_mesh,
    examine,
    grip_scale,
)


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
    longest_edge: float = 0.02
    seed: int = 0


@dataclass(frozen=True)
class BuildConfig:
    """How shapes are drawn; lengths in m, density in kg/m³.

    ``sides``: the sides of a shape's box along its axes, before it has its size. ``width``: how
    wide it is then, in the pose in which the tasks lay it down, over all yaws. ``density`` runs
    from aluminum to lead.
    """

    faces: int = 400
    sides: tuple[float, float] = (0.9, 1.25)
    width: tuple[float, float] = (0.070, 0.0755)
    density: tuple[float, float] = (2700.0, 11340.0)
    attempts: int = 400
    decomposition: DecompositionConfig = DecompositionConfig()
    soundness: SoundnessConfig = LIMITS


BUILD = BuildConfig()
"""How every shape is made; a set's manifest holds it."""


NEAR_COPIES = frozenset({(0, 244), (0, 743), (0, 772), (0, 919), (0, 991)})
"""Seed of the set and number of the shapes whose first sound draw is nearly another shape.

``shapes check`` finds them once a set is whole; they take their next sound draw.
"""


def family_of(index: int) -> str:
    """Return the family of shape number ``index``: they take turns."""
    names = tuple(FAMILIES)
    return names[index % len(names)]


def make_shape(task: tuple[int, int]) -> tuple[dict[str, Any], bytes]:
    """Return the manifest's entry and the record of a shape, of (seed of the set, index).

    Every attempt has its own random stream, so nothing depends on other shapes. ``refused`` in
    the entry counts the draws before it by reason. Runs in a worker.

    Raises:
        InfrastructureError: no attempt gave a sound shape.
    """
    root, index = task
    family = family_of(index)
    refused: Counter[str] = Counter()
    for attempt in range(BUILD.attempts):
        rng = np.random.default_rng(np.random.SeedSequence([root, index, attempt]))
        try:
            mesh = sized(FAMILIES[family](rng), rng)
            density = drawn_density(mesh, rng)
            body = weighed(mesh, density)
            measures = examine(body)
            if task in NEAR_COPIES and not refused[Reason.COPY.name]:
                raise UnsoundError(Reason.COPY)
        except UnsoundError as error:
            refused[error.reason.name] += 1
            continue
        identity = {
            "name": f"shape-{index:04d}",
            "family": family,
            "attempt": attempt,
            "refused": dict(sorted(refused.items())),
        }
        return {**identity, **entry_of(body, measures, density)}, encode(body)
    raise InfrastructureError(f"shape {index} ({family}): no sound shape in {BUILD.attempts} draws")


def entry_of(body: Body, measures: Measures, density: float) -> dict[str, Any]:
    """Return the manifest's entry of a body, SI units; mass and poses are not rounded."""
    x, y, z = body.visual.extents.tolist()
    return {
        "mass_kg": body.mass,
        "density": round(density, 3),
        "extents_m": [round(side, 6) for side in (x, y, z)],
        "volume_m3": round(measures.volume, 12),
        "convexity": round(measures.convexity, 5),
        "genus": measures.genus,
        "wall_m": round(measures.wall, 5),
        "faces": len(body.visual.faces),
        "hulls": len(body.hulls),
        "hull_vertices": sum(len(hull.vertices) for hull in body.hulls),
        "misfit": round(measures.misfit, 5),
        "outside_m": round(measures.outside, 5),
        "lifted": round(measures.lifted, 4),
        "poses": [_pose(pose) for pose in measures.poses],
        "sha256": digest(encode(body)),
        "files_sha256": files_digest(body_files(body).values()),
    }


def _pose(pose: RestPose) -> dict[str, Any]:
    return {
        "quaternion": list(pose.quaternion),
        "height_m": pose.height,
        "probability": round(pose.probability, 5),
    }


def sized(solid: Solid, rng: np.random.Generator) -> Mesh:
    """Simplify a drawn solid, bring it into its body frame and give it a random size.

    Raises:
        UnsoundError: it is not a single closed body, or no size fits both hand and bounds.
    """
    mesh = simplified(to_mesh(solid), BUILD.faces)
    check = to_solid(mesh)
    if check.is_empty() or check.volume() <= 0.0:
        raise UnsoundError(Reason.NOT_CLOSED)
    mesh = in_body_frame(mesh)
    # Solid parts as long as wide: what is flat or thin is hardly felt by a hand above it.
    sides = np.sort(rng.uniform(*BUILD.sides, size=3))[::-1]
    mesh = in_body_frame(Mesh(mesh.vertices * (sides / mesh.extents), mesh.faces))
    factor = grip_scale(mesh, rng.uniform(*BUILD.width))
    mesh = Mesh(quantized(mesh.vertices * factor), mesh.faces)
    check_mesh(mesh)
    return mesh


def drawn_density(mesh: Mesh, rng: np.random.Generator) -> float:
    """Draw a density (kg/m³), its logarithm uniform over what keeps the mass within bounds.

    Raises:
        UnsoundError: nothing does.
    """
    volume = solid_moments(mesh).volume
    low = max(BUILD.density[0], LIMITS.mass[0] * 1.0001 / volume)
    high = min(BUILD.density[1], LIMITS.mass[1] * 0.9999 / volume)
    if low > high:
        raise UnsoundError(Reason.MASS)
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def weighed(mesh: Mesh, density: float) -> Body:
    """Return the body of a mesh on the grid and in its frame, at a density in kg/m³."""
    moments = solid_moments(mesh)
    parts = convex_parts(mesh)
    hulls = tuple(hull_of(quantized(part.vertices)) for part in parts)
    ixx, iyy, izz = np.diag(moments.inertia()) * density
    inertia = (float(ixx), float(iyy), float(izz))
    body = Body(mesh, hulls, float(moments.volume * density), inertia)
    return decode(encode(body))  # what is proven is what is stored


def convex_parts(mesh: Mesh) -> tuple[Mesh, ...]:
    """Cover a closed 2-manifold mesh with convex hulls; CoACD can end the process: use a worker."""
    config = BUILD.decomposition
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
