"""Exchange shapes with other programs: objects become a set, or a set becomes files.

An object is a file of a watertight mesh that ``object_files`` reads. It can be a stranger's: the
memory of the workers that import is limited.
"""

import math
import re
import resource
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from minitouch_bench.errors import InfrastructureError, RunDirectoryError, UsageError
from minitouch_bench.files import GIB, lock_directory, os_errors_as, replace_file
from minitouch_bench.processes import run_in_workers
from minitouch_bench.protocol.spec import content_digest
from minitouch_bench.shapegen import solids, soundness
from minitouch_bench.shapegen.body_codec import body_files, digest, encode, obj_text, quantized
from minitouch_bench.shapegen.generate import (
    BUILD,
    Progress,
    entry_of,
    refuse_others,
    weighed,
    write_set,
)
from minitouch_bench.shapegen.geometry import Mesh, in_body_frame, rest_poses, solid_moments
from minitouch_bench.shapegen.manifest import MANIFEST, PACK, ShapeSet, load_shape_set
from minitouch_bench.shapegen.object_files import UnreadableError, find_objects, read_object

FAMILY = "imported"
LONGEST_STEM = 150
"""Characters of a file's name that its shape keeps."""

MOST_PARTS = 500
"""Separate surfaces in one object."""
MOST_MEMORY = 4 * GIB
"""What a worker may map to import objects, beyond what it has when it starts."""
MOST_HOLLOW = 0.001
"""Cavities, as a share of the volume, that are filled: hulls that cover an object leave some."""
FLAT = 1e-9
"""Volume, as a share of the cube over the longest side, up to which a surface encloses none."""

NOT_WATERTIGHT = (
    "not a watertight mesh; repair it in another program, such as Blender (3D Print Toolbox) "
    "or MeshLab, and import it again"
)
NO_SOLID = "no solid can be made of its surface, or too little memory is left"
HOLLOW = "hollow, with a closed cavity inside; fill the cavity, or cut an opening into it"
NO_VOLUME = "its surface encloses no volume"
CROSSING = "its faces cross each other, so that it encloses no certain volume; repair it"

LENGTH = (0.010, 0.125)
"""Twice the way from the center of mass to the farthest end, m; a record stores up to 0.13."""
USUAL_DENSITY = 1000.0
"""That of water, kg/m³."""
METERS = (1.0, 0.001, 0.01, 0.0254)
"""Meters in what the unit of a file can be: m, mm, cm, inches."""


@dataclass(frozen=True)
class ImportConfig:
    """How objects become shapes.

    ``scale`` turns the files' units into m, and ``scales`` those of single files, by name.
    ``fit`` then shrinks or grows each object into the size the Panda can grip. ``density`` in
    kg/m³; without one the nearest to 1000 at which the mass is within the bounds of a shape.

    Raises:
        UsageError: a scale is not a number above 0.
    """

    scale: float = 1.0
    fit: bool = False
    density: float | None = None
    scales: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for scale in (self.scale, *self.scales.values()):
            if not 0.0 < scale < math.inf:
                raise UsageError(f"--scale is a number above 0, not {scale:g}")


@dataclass(frozen=True)
class ImportResult:
    """The set made ("" as digest if nothing was accepted), and each refusal by file.

    ``not_promised``: what is promised of the thousand shapes and not of this object, by file.
    """

    digest: str
    accepted: int
    refused: dict[str, str]
    not_promised: dict[str, list[str]]


def import_objects(
    sources: Sequence[Path],
    folder: Path,
    config: ImportConfig,
    workers: int = 1,
    progress: Progress = lambda *_: None,
    *,
    fresh: bool = False,
) -> ImportResult:
    """Import files, and every object below folders, into a new set in ``folder``.

    ``fresh``: an imported set that is there already is replaced when the new one is complete.

    Raises:
        UsageError: there are no objects, or none of a name that has a scale of its own.
        RunDirectoryError: ``folder`` contains a set already, or another process works there.
        InfrastructureError: the folder cannot be written.
    """
    objects = find_objects(sources)
    if unknown := config.scales.keys() - objects.keys():
        raise UsageError(f"--scale: no object is called '{min(unknown)}'")
    with lock_directory(folder):
        _check_output(folder, fresh=fresh)
        answers = _import_all(objects, config, workers, progress)
        refused, not_promised = dict[str, str](), dict[str, list[str]]()
        kept, first = [], dict[str, str]()
        for name, plain in zip(objects, _plain_names(objects), strict=True):
            reason, entry, record = answers[name]
            if reason:
                refused[name] = reason
                continue
            not_promised[name] = entry["not_promised"]
            if (same := first.setdefault(digest(record), name)) != name:
                not_promised[name].append(f"{soundness.Reason.COPY} ({same})")
            kept.append(({"name": plain, "family": FAMILY, "source": name, **entry}, record))
        set_digest = ""
        if kept:
            how: dict[str, Any] = {"scale": config.scale, "fit": config.fit}
            if config.scales:
                how["scales"] = dict(config.scales)
            header = {"name": folder.absolute().name, "imported": how, "refused": refused}
            set_digest = content_digest(write_set(folder, header, kept))
    return ImportResult(set_digest, len(kept), refused, not_promised)


def _check_output(folder: Path, *, fresh: bool) -> None:
    """Check that a set may be written.

    Raises:
        RunDirectoryError: there is a set that may not be replaced, or other files.
    """
    if (folder / MANIFEST).exists():
        if not fresh:
            raise RunDirectoryError(
                f"{folder} contains a shape set already; choose another --output, or replace an "
                "imported set with --fresh"
            )
        if "imported" not in load_shape_set(folder).document:
            raise RunDirectoryError(f"{folder} contains a set that was not imported: it is kept")
    else:
        refuse_others(folder, PACK)


def _import_all(
    objects: Mapping[str, Path], config: ImportConfig, workers: int, progress: Progress
) -> dict[str, "Imported"]:
    """Import each object in a worker; return the answers by name, in the order of the objects."""
    tasks = [
        (path, replace(config, scale=config.scales.get(name, config.scale)))
        for name, path in objects.items()
    ]
    answers: dict[int, Imported] = {}
    for place, answer in run_in_workers(
        import_in_worker,
        tasks,
        workers,
        name=lambda task: str(task[0]),
        ended=lambda text: (f"{NO_SOLID}: {text}", {}, b""),
    ):
        answers[place] = answer
        progress(len(answers), len(tasks))
    return {name: answers[place] for place, name in enumerate(objects)}


Imported = tuple[str, dict[str, Any], bytes]
"""Of one file: the reason it is refused or "", its entry in the manifest, and its record."""


def import_in_worker(task: tuple[Path, ImportConfig]) -> Imported:
    """Import one file in a process of its own, whose memory is then limited for good."""
    _limit_memory()
    with np.errstate(all="ignore"):  # its warnings are of a mesh that is refused
        return import_one(task)


@cache
def _limit_memory() -> None:
    with suppress(OSError, ValueError):  # not Linux, or the limit is lower already
        mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (mapped + MOST_MEMORY, hard))


def import_one(task: tuple[Path, ImportConfig]) -> Imported:
    """Import one file.

    Raises:
        OSError: something failed that is not the file's fault.
    """
    path, config = task
    try:
        given = read_object(path)
        closed = closed_mesh(given)
        scale = _fitting(closed) if config.fit else config.scale
        try:
            entry, record = shape_of(closed, scale, config.density)
        except soundness.UnsoundError as error:
            advice = "" if config.fit else _advice(closed, config, error.reason)
            return f"{error}{advice}", {}, b""
    except (UnreadableError, soundness.UnsoundError) as error:
        return str(error), {}, b""
    except MemoryError:
        return f"it takes more than {MOST_MEMORY // GIB} GiB of memory", {}, b""
    except OSError:
        raise
    except Exception as error:  # a degenerate surface can fail in any step
        return f"no solid can be made of its surface ({type(error).__name__})", {}, b""
    sides = [round(side * scale, 6) for side in given.extents.tolist()]
    return "", {"sides_m": sides, **entry}, record


def shape_of(
    closed: Mesh, scale: float, density: float | None = None
) -> tuple[dict[str, Any], bytes]:
    """Return the manifest's entry and the record of a closed mesh in its body frame.

    Raises:
        UnsoundError: it cannot be an object at this scale.
    """
    mesh = _sized(closed, scale)
    missed: dict[soundness.Reason, str] = {}
    soundness.check_mesh(mesh, missed.__setitem__)  # before CoACD, which takes long
    volume = solid_moments(mesh).volume
    low, high = (mass / volume for mass in soundness.LIMITS.mass)
    density = density or float(np.clip(USUAL_DENSITY, low * 1.0001, high * 0.9999))
    body = weighed(mesh, density)
    measures = soundness.check_body(body, missed.__setitem__)
    soundness.check_usable(body, measures["poses"][0], missed.__setitem__)
    not_promised = [f"{reason} ({detail})" for reason, detail in missed.items()]
    return {**entry_of(body, measures, density), "not_promised": not_promised}, encode(body)


def _advice(closed: Mesh, config: ImportConfig, reason: soundness.Reason) -> str:
    """Return a scale that is accepted, in words; "" where the size is not the reason.

    The units that give a possible length are tried first, then the scale that ``--fit`` takes.
    """
    if reason not in (soundness.Reason.SIZE, soundness.Reason.UNSEEN):
        return ""
    said, (low, high) = "", LENGTH
    units = [unit for unit in METERS if low <= _length(closed) * unit <= high]
    for scale in (*units, float(f"{_fitting(closed):.3g}")):
        try:
            shape_of(closed, scale, config.density)
        except soundness.UnsoundError as error:
            said = f"with --scale {scale:g} {error}"
        else:
            return f"; accepted with --scale {scale:g}"
    return f"; no accepted scale was found; {said}"


def closed_mesh(mesh: Mesh) -> Mesh:
    """Return a closed mesh of about 400 faces in its body frame, in the units of the file.

    Raises:
        UnreadableError: it is not the surface of a solid.
    """
    moved = in_body_frame(solids.simplified_solid(_solid_of(mesh), BUILD.faces))
    low, high = moved.vertices.min(axis=0), moved.vertices.max(axis=0)
    moments = np.diag(solid_moments(moved).inertia)
    # Of a solid all three are true: no moment is as large as the two others together.
    if not ((low < 0.0) & (high > 0.0) & (2.0 * moments < moments.sum())).all():
        raise UnreadableError(CROSSING)
    return moved


def _sized(closed: Mesh, scale: float) -> Mesh:
    """Return a mesh on the grid of a record, ``scale`` m to a unit.

    Raises:
        UnsoundError: it is too long or too short.
    """
    length, (low, high) = _length(closed) * scale, LENGTH
    if not low <= length <= high:
        limits = f"{low * 1000:.0f} to {soundness.in_mm(high, 0)}"
        found = f"{soundness.in_mm(length)}, not {limits}"
        raise soundness.UnsoundError(soundness.Reason.SIZE, found)
    mesh = Mesh(quantized(closed.vertices * scale), closed.faces)
    # Slivers may have lost their area to the grid; the way through a solid drops them.
    cleaned = solids.to_mesh(solids.to_solid(mesh))
    if not len(cleaned.faces):
        raise soundness.UnsoundError(
            soundness.Reason.THIN_WALL, "nothing of it is left on the grid"
        )
    return Mesh(quantized(cleaned.vertices), cleaned.faces)


def _length(closed: Mesh) -> float:
    """Return twice the longest way from the center of mass along an axis."""
    return 2.0 * float(np.abs(closed.vertices).max())


def _unit_hull(closed: Mesh) -> Mesh:
    """Return the hull of a mesh at a length of 1 m: what it can rest on is computed in m."""
    return solids.hull_of(closed.vertices / _length(closed))


def _fitting(closed: Mesh) -> float:
    """Return the scale at which a mesh is as wide as the hand can grip, or no wider as it lies."""
    hull = _unit_hull(closed)
    try:
        factor = soundness.grip_scale(hull, BUILD.width[1])
    except soundness.UnsoundError:
        height, across = soundness.height_and_width(hull, rest_poses(hull)[0])
        factor = min(BUILD.width[1] / across, soundness.HIGHEST_PUSHED * 0.99 / height)
    return factor / _length(closed)


def _solid_of(mesh: Mesh) -> solids.Solid:
    """Return the solid of a watertight mesh, as one body where its parts overlap or touch.

    A part may be turned inward; inside another part that means a cavity.

    Raises:
        UnreadableError: it is not watertight, hollow, or of too many parts.
    """
    solid = solids.to_solid(mesh)
    if solid.is_empty():
        raise UnreadableError(NOT_WATERTIGHT)
    parts = solid.decompose()
    if len(parts) > MOST_PARTS:
        raise UnreadableError(f"{len(parts)} separate surfaces, at most {MOST_PARTS}")
    if solid.volume() < 0.0:
        parts = [solids.turned(part) for part in parts]
    bodies = [part for part in parts if part.volume() > 0.0]
    inward = [solids.turned(part) for part in parts if part.volume() < 0.0]
    if sum(part.volume() for part in (*bodies, *inward)) < FLAT * float(mesh.extents.max()) ** 3:
        raise UnreadableError(NO_VOLUME)
    whole, cavities = solids.union(bodies), 0.0
    for part in inward:
        if (part - whole).volume() < 0.001 * part.volume():
            cavities += part.volume()
        else:
            bodies.append(part)
    if len(bodies) > 1:
        # Grown by a thousandth on each side, hulls that only touch become one body.
        joined = solids.union([solids.grown(part, 1.002) for part in bodies]).decompose()
        bodies = [part for part in joined if part.volume() > 0.0]
        whole = solids.union(bodies)
        cavities -= sum(part.volume() for part in joined if part.volume() < 0.0)
    if cavities > MOST_HOLLOW * whole.volume():
        raise UnreadableError(HOLLOW)
    return whole


def _plain_names(sources: Iterable[str]) -> list[str]:
    """Return a shape's name for each file, fit for ``manifest.PlainName``, no two alike."""
    names: dict[str, None] = {}
    for source in sources:
        plain = re.sub("[^A-Za-z0-9._-]+", "_", source.rpartition(".")[0].replace("/", "-"))
        stem = name = plain.lstrip("._-")[:LONGEST_STEM] or "object"
        number = 1
        while name in names:
            number += 1
            name = f"{stem}-{number}"
        names[name] = None
    return list(names)


def export_shapes(shapes: ShapeSet, folder: Path, form: str, split: str | None = None) -> int:
    """Write every shape, or those of one split, into a folder; return the number of files.

    Raises:
        UsageError: the format or the split is unknown.
        InfrastructureError: the folder cannot be written.
    """
    written = 0
    with os_errors_as(InfrastructureError, folder, "written"):
        folder.mkdir(parents=True, exist_ok=True)
        for shape in shapes.split(split) if split else shapes.shapes:
            files = body_files(shape.body(), shape.name)
            if form == "obj":
                files = {f"{shape.name}.obj": obj_text((shape.body().visual,)).encode()}
            for name, content in files.items():
                replace_file(folder / name, content)
            written += len(files)
    return written
