"""What makes a shape sound: every criterion, its limit, and the reason a refusal gives.

All criteria are computed, never timed, so that a slow machine makes the same shapes.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from minitouch_bench.shapegen.grips import GripRig, open_rig
from minitouch_bench.shapegen.mesh import (
    Mesh,
    Points,
    distances_to_surface,
    surface_points,
    thinnest_wall,
    widest_across,
)
from minitouch_bench.shapegen.poses import RestPose, rest_poses
from minitouch_bench.shapegen.record import Body
from minitouch_bench.shapegen.solids import (
    hull_of,
    symmetric_difference,
    to_mesh,
    to_solid,
    union_of,
)

GOLDEN = 0.618034
"""Shift of the yaws from one pose to the next: any number of poses fills the circle evenly."""


class Reason(StrEnum):
    """Why a shape is refused."""

    NOT_FINITE = "a vertex, mass or moment is not a finite number"
    NOT_CLOSED = "not a closed 2-manifold"
    SEVERAL_BODIES = "more than one body"
    GENUS = "too many handles through it"
    THIN_WALL = "a wall is too thin"
    SIZE = "longest side outside 40-70 mm"
    FACES = "too many faces"
    MASS = "mass outside 50-500 g"
    INERTIA = "moments of inertia no body can have"
    HULLS = "too many hulls or hull vertices"
    MISFIT = "hulls differ from the mesh by too large a volume"
    OUTSIDE = "a hull stands out too far from the mesh"
    FEW_POSES = "fewer than two stable poses"
    RESTLESS = "jitters at rest"
    SINKS = "sinks into the table or floats above it"
    TOO_FLAT = "too low to grip in a stable pose"
    TOO_WIDE = "wider than 70 mm across the fingers at some yaw"
    SLIPS = "cannot be lifted by two fingers"


@dataclass(frozen=True)
class SoundnessConfig:
    """Limits; lengths in m, masses in kg, speeds in m/s and rad/s, angles in rad."""

    longest_side: tuple[float, float] = (0.040, 0.070)
    mass: tuple[float, float] = (0.050, 0.500)
    max_faces: int = 440
    max_genus: int = 4
    least_wall: float = 0.0022
    max_hulls: int = 16
    max_hull_vertices: int = 64
    misfit: float = 0.12
    outside: float = 0.004
    tilt: float = 0.14
    speed: float = 0.005
    spin: float = 0.15
    gap: tuple[float, float] = (-0.0005, 0.0025)
    least_height: float = 0.016
    widest: float = 0.070
    margin: float = 0.001
    yaws: int = 3
    trial_poses: int = 5
    least_share: float = 0.05
    slips: float = 0.12


class UnsoundError(Exception):
    """A shape fails a criterion; ``reason`` names it, ``detail`` gives the number."""

    def __init__(self, reason: Reason, detail: str = "") -> None:
        """Keep the reason for counting."""
        super().__init__(f"{reason.value}{f' ({detail})' if detail else ''}")
        self.reason = reason


@dataclass(frozen=True)
class Measures:
    """What was measured on a sound shape: SI units, ``misfit`` and ``convexity`` as shares.

    ``lifted`` is the share of grip trials, weighted by pose, in which the shape came up.
    """

    volume: float
    convexity: float
    genus: int
    wall: float
    misfit: float
    outside: float
    lifted: float
    poses: tuple[RestPose, ...]


def check_mesh(mesh: Mesh, config: SoundnessConfig) -> tuple[int, float]:
    """Check a visual mesh on its own; return its genus and its thinnest wall in m.

    Raises:
        UnsoundError: a criterion fails.
    """
    if not np.isfinite(mesh.vertices).all():
        raise UnsoundError(Reason.NOT_FINITE)
    if len(mesh.faces) > config.max_faces:
        raise UnsoundError(Reason.FACES, str(len(mesh.faces)))
    solid = to_solid(mesh)
    if solid.is_empty() or solid.num_tri() != len(mesh.faces) or solid.volume() <= 0.0:
        raise UnsoundError(Reason.NOT_CLOSED)
    if len(solid.decompose()) != 1:
        raise UnsoundError(Reason.SEVERAL_BODIES)
    low, high = config.longest_side
    longest = float(mesh.extents.max())
    if not low <= longest <= high:
        raise UnsoundError(Reason.SIZE, f"{longest * 1000:.1f} mm")
    genus = int(solid.genus())
    if genus > config.max_genus:
        raise UnsoundError(Reason.GENUS, str(genus))
    wall = thinnest_wall(mesh)
    if wall < config.least_wall:
        raise UnsoundError(Reason.THIN_WALL, f"{wall * 1000:.1f} mm")
    return genus, wall


def check_hulls(body: Body, config: SoundnessConfig) -> tuple[float, float]:
    """Check the hulls against the mesh; return the misfit (share) and the overhang (m).

    Raises:
        UnsoundError: a criterion fails.
    """
    sizes = [len(hull.vertices) for hull in body.hulls]
    if not 1 <= len(sizes) <= config.max_hulls or max(sizes) > config.max_hull_vertices:
        raise UnsoundError(Reason.HULLS, f"{len(sizes)} hulls, up to {max(sizes, default=0)}")
    solid, union = to_solid(body.visual), union_of(body.hulls)
    if any(to_solid(hull).is_empty() for hull in body.hulls):
        raise UnsoundError(Reason.NOT_CLOSED, "a hull")
    misfit = symmetric_difference(union, solid) / float(solid.volume())
    if misfit > config.misfit:
        raise UnsoundError(Reason.MISFIT, f"{misfit:.3f}")
    excess = to_mesh(union - solid)
    outside = 0.0
    if len(excess.faces):
        # One point in each 1.5 mm cell: booleans leave many slivers, and many points on them.
        cloud = surface_points(excess, 0.005)
        _, kept = np.unique(np.rint(cloud / 0.0015), axis=0, return_index=True)
        cloud = cloud[kept]
        outside = float(distances_to_surface(cloud, body.visual).max())
    if outside > config.outside:
        raise UnsoundError(Reason.OUTSIDE, f"{outside * 1000:.1f} mm")
    return misfit, outside


def check_numbers(body: Body, config: SoundnessConfig) -> None:
    """Check mass and moments of inertia.

    Raises:
        UnsoundError: a criterion fails.
    """
    numbers = np.array([body.mass, *body.inertia])
    if not np.isfinite(numbers).all():
        raise UnsoundError(Reason.NOT_FINITE, "mass or inertia")
    if not config.mass[0] <= body.mass <= config.mass[1]:
        raise UnsoundError(Reason.MASS, f"{body.mass * 1000:.1f} g")
    moments = np.sort(numbers[1:])
    if moments[0] <= 0.0 or moments[2] > moments[0] + moments[1]:
        raise UnsoundError(Reason.INERTIA)


def examine(body: Body, config: SoundnessConfig) -> Measures:
    """Check a body by every criterion, cheapest first, and return what was measured.

    Raises:
        UnsoundError: the first criterion that fails.
    """
    check_numbers(body, config)
    genus, wall = check_mesh(body.visual, config)
    misfit, outside = check_hulls(body, config)
    hull = hull_of(np.concatenate([part.vertices for part in body.hulls]))
    poses = tuple(statically_sound(hull, config))
    with open_rig(body) as rig:
        poses = with_shares(hull, settled_poses(rig, poses, config))
        lifted = lifted_share(rig, poses, surface_points(body.visual, 0.003), config)
    volume = float(to_solid(body.visual).volume())
    convexity = volume / float(to_solid(hull_of(body.visual.vertices)).volume())
    return Measures(volume, convexity, genus, wall, misfit, outside, lifted, poses)


def statically_sound(hull: Mesh, config: SoundnessConfig) -> Iterator[RestPose]:
    """Yield the stable poses of a hull, all of them low and wide enough for the fingers.

    Raises:
        UnsoundError: there are fewer than two, or one is too flat or too wide.
    """
    poses = rest_poses(hull, config.least_share)
    if len(poses) < 2:
        raise UnsoundError(Reason.FEW_POSES)
    for pose in poses:
        placed = hull.vertices @ pose.rotation.T
        height = float(np.ptp(placed[:, 2]))
        if height < config.least_height:
            raise UnsoundError(Reason.TOO_FLAT, f"{height * 1000:.1f} mm")
        width = widest_across(placed[:, :2]) + 2.0 * config.margin
        if width > config.widest:
            raise UnsoundError(Reason.TOO_WIDE, f"{width * 1000:.1f} mm")
        yield pose


def settled_poses(
    rig: GripRig, poses: tuple[RestPose, ...], config: SoundnessConfig
) -> tuple[RestPose, ...]:
    """Return the poses that hold in the simulator, as it leaves them.

    Raises:
        UnsoundError: one jitters or sinks, or fewer than two hold.
    """
    held: list[RestPose] = []
    for pose in poses:
        rest = rig.settle(pose)
        if not config.gap[0] <= rest.gap <= config.gap[1]:
            raise UnsoundError(Reason.SINKS, f"{rest.gap * 1000:.2f} mm")
        if rest.tilt > config.tilt:
            continue
        if rest.speed > config.speed or rest.spin > config.spin:
            raise UnsoundError(Reason.RESTLESS, f"{rest.speed:.4f} m/s, {rest.spin:.3f} rad/s")
        settled = RestPose(rest.quaternion, rest.height, pose.probability)
        down = settled.rotation[2]
        if all(down @ other.rotation[2] < np.cos(config.tilt) for other in held):
            held.append(settled)
    if len(held) < 2:
        raise UnsoundError(Reason.FEW_POSES)
    return tuple(held)


def with_shares(hull: Mesh, held: tuple[RestPose, ...]) -> tuple[RestPose, ...]:
    """Return held poses, likeliest first, with shares of all drops that sum to 1.

    Every face a drop can end on, however small, counts for the held pose nearest to it.
    """
    downs = np.array([pose.rotation[2] for pose in held])
    shares = np.zeros(len(held))
    for pose in rest_poses(hull, 0.0):
        shares[int((downs @ pose.rotation[2]).argmax())] += pose.probability
    shares /= shares.sum()
    order = np.argsort(-shares.round(6), kind="stable")
    return tuple(RestPose(held[i].quaternion, held[i].height, float(shares[i])) for i in order)


def lifted_share(
    rig: GripRig, poses: tuple[RestPose, ...], surface: Points, config: SoundnessConfig
) -> float:
    """Return the share of grip trials that lift the body, weighted by pose.

    The likeliest poses are tried at evenly spaced yaws, in each pose at other ones.

    Raises:
        UnsoundError: too many fail.
    """
    failed = 0.0
    tried = poses[: config.trial_poses]
    total = sum(pose.probability for pose in tried)
    for number, pose in enumerate(tried):
        for step in range(config.yaws):
            angle = np.pi * (step + number * GOLDEN) / config.yaws
            if not rig.lift(pose, angle, surface):
                failed += pose.probability / total / config.yaws
                if failed > config.slips:
                    raise UnsoundError(Reason.SLIPS)
    return 1.0 - failed
