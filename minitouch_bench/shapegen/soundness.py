"""What makes a shape sound: every criterion, its limit, and the reason a refusal gives.

All criteria are computed, never timed, so that a slow machine makes the same shapes. A check raises
``UnsoundError`` for a criterion that fails, or tells ``refuse`` of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.shapegen import geometry
from minitouch_bench.shapegen.body_codec import Body
from minitouch_bench.shapegen.geometry import Mesh, Points, RestPose
from minitouch_bench.shapegen.grips import GripRig, open_rig
from minitouch_bench.shapegen.solids import hull_of, to_mesh, to_solid, union


class Reason(StrEnum):
    """Why a shape is refused."""

    NOT_FINITE = "a vertex, mass or moment is not a finite number"
    NOT_CLOSED = "not a closed 2-manifold"
    SEVERAL_BODIES = "more than one body"
    GENUS = "too many handles through it"
    THIN_WALL = "a wall is too thin"
    SIZE = "too long or too short"
    FACES = "too many faces"
    MASS = "too light or too heavy"
    INERTIA = "moments of inertia no body can have"
    HULLS = "too many hulls or hull vertices"
    MISFIT = "hulls differ from the mesh by too large a volume"
    OUTSIDE = "a hull stands out too far from the mesh"
    FEW_POSES = "fewer than two stable poses"
    RESTLESS = "jitters at rest"
    SINKS = "sinks into the table or floats above it"
    TOO_FLAT = "too low in every stable pose"
    TOO_WIDE = "too wide for the fingers where it is high enough"
    SLIPS = "cannot be lifted by two fingers"
    COPY = "nearly the same solid as another shape"
    IN_HAND = "so high that the hand can begin inside it in Pushing"
    UNSEEN = "too small for the policy's camera"


@dataclass(frozen=True)
class SoundnessConfig:
    """Limits; lengths in m, masses in kg, speeds in m/s and rad/s, angles in rad.

    ``least_height`` and ``widest`` hold for the pose in which the tasks lay a shape down: high
    enough that a hand which moves at random meets it, and at no yaw wider than the open fingers
    (80 mm) with room to spare. ``margin`` is what PyBullet adds on each side. ``slips``: share
    of the ``yaws`` at which the fingers may fail to lift it.
    """

    longest_side: tuple[float, float] = (0.050, 0.095)
    mass: tuple[float, float] = (1.2, 3.5)
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
    least_height: float = 0.055
    widest: float = 0.078
    margin: float = 0.001
    yaws: int = 8
    least_share: float = 0.05
    slips: float = 0.125


LIMITS = SoundnessConfig()
"""The limits of every generated set; of an imported object most are measured only."""


HIGHEST, WIDEST = 0.100, 0.120
"""Of an imported object as it lies, m: the hand begins beside it in Playing and Pick-up."""
HIGHEST_PUSHED = 0.080
"""In Pushing the hand begins lower: up to this height it is clear of an object, m."""


class UnsoundError(Exception):
    """A shape fails a criterion; ``reason`` names it, ``detail`` gives the number."""

    def __init__(self, reason: Reason, detail: str = "") -> None:
        """Keep the reason for counting."""
        super().__init__(f"{reason.value}{f' ({detail})' if detail else ''}")
        self.reason = reason


Refuse = Callable[[Reason, str], None]
"""Called with each criterion that fails and its number, where a check can go on after it."""


def strictly(reason: Reason, detail: str) -> None:
    """Refuse a body for the first criterion that fails.

    Raises:
        UnsoundError: always.
    """
    raise UnsoundError(reason, detail)


def in_mm(length: float, digits: int = 1) -> str:
    """Write a length in m for people."""
    return f"{length * 1000:.{digits}f} mm"


def check_mesh(mesh: Mesh, refuse: Refuse = strictly) -> tuple[int, float]:
    """Check a visual mesh on its own; return its genus and its thinnest wall in m."""
    if len(mesh.faces) > LIMITS.max_faces:
        raise UnsoundError(Reason.FACES, f"{len(mesh.faces)}, at most {LIMITS.max_faces}")
    solid = to_solid(mesh)
    if solid.is_empty() or solid.num_tri() != len(mesh.faces) or solid.volume() <= 0.0:
        raise UnsoundError(Reason.NOT_CLOSED)
    if (count := len(solid.decompose())) != 1:
        raise UnsoundError(Reason.SEVERAL_BODIES, f"{count}; join them, or give each a file")
    low, high = LIMITS.longest_side
    longest = float(mesh.extents.max())
    if not low <= longest <= high:
        refuse(Reason.SIZE, f"{in_mm(longest)}, not {low * 1000:.0f} to {in_mm(high, 0)}")
    genus = int(solid.genus())
    if genus > LIMITS.max_genus:
        refuse(Reason.GENUS, f"{genus}, at most {LIMITS.max_genus}")
    wall = geometry.thinnest_wall(mesh)
    if wall < LIMITS.least_wall:
        refuse(Reason.THIN_WALL, f"{in_mm(wall)}, at least {in_mm(LIMITS.least_wall)}")
    return genus, wall


def check_hulls(body: Body, refuse: Refuse = strictly) -> tuple[float, float]:
    """Check the hulls against the mesh; return the misfit (share) and the overhang (m)."""
    sizes = [len(hull.vertices) for hull in body.hulls]
    if not 1 <= len(sizes) <= LIMITS.max_hulls or max(sizes) > LIMITS.max_hull_vertices:
        raise UnsoundError(Reason.HULLS, f"{len(sizes)} hulls, up to {max(sizes, default=0)}")
    solid, parts = to_solid(body.visual), [to_solid(hull) for hull in body.hulls]
    if any(part.is_empty() for part in parts):
        raise UnsoundError(Reason.NOT_CLOSED, "a hull")
    cover = union(parts)
    excess = cover - solid
    misfit = (excess.volume() + (solid - cover).volume()) / solid.volume()
    if misfit > LIMITS.misfit:
        refuse(Reason.MISFIT, f"{misfit:.3f}, at most {LIMITS.misfit}")
    outside = 0.0
    if not excess.is_empty():
        # One point in each 1.5 mm cell: booleans leave many slivers, and many points on them.
        cloud = geometry.surface_points(to_mesh(excess), 0.005)
        _, kept = np.unique(np.rint(cloud / 0.0015), axis=0, return_index=True)
        cloud = cloud[kept]
        outside = float(geometry.distances_to_surface(cloud, body.visual).max())
    if outside > LIMITS.outside:
        refuse(Reason.OUTSIDE, f"{in_mm(outside)}, at most {in_mm(LIMITS.outside)}")
    return misfit, outside


def check_numbers(body: Body, refuse: Refuse = strictly) -> None:
    """Check mass and moments of inertia."""
    numbers = np.array([body.mass, *body.inertia])
    if not np.isfinite(numbers).all():
        raise UnsoundError(Reason.NOT_FINITE, "mass or inertia")
    low, high = LIMITS.mass
    if not low <= body.mass <= high:
        refuse(Reason.MASS, f"{body.mass:.3f} kg, not {low} to {high} kg")
    moments = np.sort(numbers[1:])
    if moments[0] <= 0.0 or moments[2] > moments[0] + moments[1]:
        raise UnsoundError(Reason.INERTIA)


def check_body(body: Body, refuse: Refuse = strictly) -> dict[str, Any]:
    """Check a body by every criterion, cheapest first, and return what was measured.

    By the manifest's keys, in SI units, ``misfit`` and ``convexity`` as shares. ``lifted`` is the
    share of grip trials in which the shape came up. ``poses``: the one in which the tasks lay it
    down, then the others, likeliest first.

    With another ``refuse`` than ``strictly`` what the set promises is measured only: sizes, poses
    and grips. A body that is not closed, not one or not at rest on the table is refused always.

    Raises:
        UnsoundError: the first criterion that fails.
    """
    check_numbers(body, refuse)
    genus, wall = check_mesh(body.visual, refuse)
    misfit, outside = check_hulls(body, refuse)
    hull = hull_of(np.concatenate([part.vertices for part in body.hulls]))
    with open_rig(body) as rig:
        held = with_shares(hull, settled_poses(rig, stable_poses(hull, refuse), refuse))
        laid = held[laid_pose(hull, held, refuse)]
        lifted = lifted_share(rig, laid, geometry.surface_points(body.visual, 0.003), refuse)
    volume = float(to_solid(body.visual).volume())
    convexity = volume / float(to_solid(hull_of(body.visual.vertices)).volume())
    return {
        "volume_m3": round(volume, 12),
        "convexity": round(convexity, 5),
        "genus": genus,
        "wall_m": round(wall, 5),
        "misfit": round(misfit, 5),
        "outside_m": round(outside, 5),
        "lifted": round(lifted, 4),
        "poses": (laid, *(pose for pose in held if pose is not laid)),
    }


def check_usable(body: Body, pose: RestPose, refuse: Refuse) -> None:
    """Check what an evaluation needs of any object: the hand's place, and to be seen.

    Raises:
        UnsoundError: the hand can begin inside it, or the policy's camera hardly sees it.
    """
    height, across = (round(side, 4) for side in height_and_width(body.visual, pose))
    if height > HIGHEST or across > WIDEST:
        limits = f"at most {in_mm(HIGHEST, 0)} and {in_mm(WIDEST, 0)}"
        found = f"{in_mm(height)} high and {in_mm(across)} wide as it lies, {limits}"
        raise UnsoundError(Reason.SIZE, found)
    if height > HIGHEST_PUSHED:
        refuse(Reason.IN_HAND, f"{in_mm(height)}, not at most {in_mm(HIGHEST_PUSHED, 0)}")
    with open_rig(body) as rig:
        pixels = rig.visible_pixels(pose)
    if pixels < (least := PROTOCOL.observation.least_visible_pixels):
        raise UnsoundError(Reason.UNSEEN, f"{pixels} pixels where it is farthest, not {least}")


def stable_poses(hull: Mesh, refuse: Refuse = strictly) -> tuple[RestPose, ...]:
    """Return the stable poses of a hull by statics, likeliest first."""
    poses = geometry.rest_poses(hull, LIMITS.least_share)
    if len(poses) < 2:
        refuse(Reason.FEW_POSES, str(len(poses)))
        poses = poses or geometry.rest_poses(hull)[:1]  # a ball rests anywhere
    laid_pose(hull, poses, refuse)
    return poses


def laid_pose(hull: Mesh, poses: Sequence[RestPose], refuse: Refuse = strictly) -> int:
    """Return the likeliest of a hull's poses that is high enough, and at no yaw too wide."""
    boxes = [height_and_width(hull, pose) for pose in poses]
    high = [index for index, (height, _) in enumerate(boxes) if height >= LIMITS.least_height]
    if not high:
        high = [*range(len(boxes))]
        highest = in_mm(max(height for height, _ in boxes), 2)
        refuse(Reason.TOO_FLAT, f"{highest}, not at least {in_mm(LIMITS.least_height, 0)}")
    for index in high:
        if boxes[index][1] + 2.0 * LIMITS.margin <= LIMITS.widest:
            return index
    narrowest = in_mm(min(boxes[index][1] for index in high) + 2.0 * LIMITS.margin)
    refuse(Reason.TOO_WIDE, f"{narrowest}, not at most {in_mm(LIMITS.widest, 0)}")
    return high[0]


def height_and_width(mesh: Mesh, pose: RestPose) -> tuple[float, float]:
    """Return the height of a mesh in a pose and its largest width over all yaws, in m."""
    placed = mesh.vertices @ pose.rotation.T
    return float(np.ptp(placed[:, 2])), geometry.widest_across(placed[:, :2])


def grip_scale(mesh: Mesh, width: float) -> float:
    """Return the factor at which a mesh is ``width`` (m) wide in the pose the tasks lay it in."""
    hull = hull_of(mesh.vertices)
    poses = geometry.rest_poses(hull, LIMITS.least_share)
    if not poses:
        raise UnsoundError(Reason.FEW_POSES)
    longest = float(mesh.extents.max())
    for pose in poses:
        height, across = height_and_width(hull, pose)
        factor = width / across
        if height * factor >= LIMITS.least_height and longest * factor <= LIMITS.longest_side[1]:
            return factor
    raise UnsoundError(Reason.TOO_FLAT)


def settled_poses(
    rig: GripRig, poses: tuple[RestPose, ...], refuse: Refuse = strictly
) -> tuple[RestPose, ...]:
    """Return the poses that hold in the simulator, as it leaves them."""
    held: list[RestPose] = []
    for pose in poses:
        rest = rig.settle(pose)
        if not LIMITS.gap[0] <= rest.gap <= LIMITS.gap[1]:
            raise UnsoundError(Reason.SINKS, in_mm(rest.gap, 2))
        if rest.tilt > LIMITS.tilt:
            continue
        if rest.speed > LIMITS.speed or rest.spin > LIMITS.spin:
            refuse(Reason.RESTLESS, f"{rest.speed:.4f} m/s, {rest.spin:.3f} rad/s")
        settled = RestPose(rest.quaternion, rest.height, pose.probability)
        down = settled.rotation[2]
        if all(down @ other.rotation[2] < np.cos(LIMITS.tilt) for other in held):
            held.append(settled)
    if len(held) < 2:
        refuse(Reason.FEW_POSES, str(len(held)))
    return tuple(held) or poses[:1]


def with_shares(hull: Mesh, held: tuple[RestPose, ...]) -> tuple[RestPose, ...]:
    """Return held poses, likeliest first, each with the drops that end nearest to it."""
    downs = np.array([pose.rotation[2] for pose in held])
    shares = np.zeros(len(held))
    for pose in geometry.rest_poses(hull, 0.0):
        shares[int((downs @ pose.rotation[2]).argmax())] += pose.probability
    shares /= shares.sum()
    order = np.argsort(-shares.round(6), kind="stable")
    return tuple(
        RestPose(held[i].quaternion, held[i].height, round(float(shares[i]), 5)) for i in order
    )


def lifted_share(rig: GripRig, pose: RestPose, surface: Points, refuse: Refuse = strictly) -> float:
    """Return the share of evenly spaced yaws at which two fingers lift the body from a pose."""
    failed = 0
    for step in range(LIMITS.yaws):
        failed += not rig.lift(pose, np.pi * step / LIMITS.yaws, surface)
        if failed > LIMITS.slips * LIMITS.yaws:
            refuse(Reason.SLIPS, f"{failed} of {LIMITS.yaws} grips fail")
    return 1.0 - failed / LIMITS.yaws
