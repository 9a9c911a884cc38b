"""Shape sets: read one, verify it, and hand out its shapes as files a simulator loads.

A set is a folder with ``manifest.json`` and ``shapes.bin``, the records one after another.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from minitouch_bench.cache import cache_directory, cache_errors
from minitouch_bench.errors import UsageError
from minitouch_bench.files import GIB, MIB, read_file, replace_file
from minitouch_bench.shapegen.poses import RestPose
from minitouch_bench.shapegen.record import Body, body_files, decode, digest, file_names

MANIFEST = "manifest.json"
PACK = "shapes.bin"
SCHEMA = "minitouch-shapes-1"
CANONICAL = "minitouch-1000"


@dataclass(frozen=True)
class Shape:
    """One object of a set. ``mass`` in kg, ``extents`` (its sides along its own axes) in m.

    ``poses``: the ways it lies on a table, likeliest first; the height is that of the center
    of mass, which is the origin of its frame. ``digest`` is the SHA-256 of its record.
    ``entry`` is everything the manifest says about it.
    """

    name: str
    family: str
    split: str
    mass: float
    extents: tuple[float, float, float]
    poses: tuple[RestPose, ...]
    digest: str
    entry: Mapping[str, Any]
    pack: Path

    @property
    def urdf(self) -> Path:
        """Absolute path of its URDF in the cache, with its meshes beside it.

        The files are read and hashed each time (0.1 ms), so a damaged one is never used: it
        is written again from the record.

        Raises:
            UsageError: the record is damaged, or does not give the files of the manifest.
            InfrastructureError: the cache cannot be written.
        """
        names = file_names(self.digest)
        folder = cache_directory() / "shapes" / self.digest[:2]
        promised = str(self.entry["files_sha256"])
        if _hash_of(folder, names) != promised:
            files = body_files(self.body())
            if files.sha256 != promised:
                raise UsageError(
                    f"shape {self.digest[:20]}: its files differ from the manifest's; "
                    "the set was made by another version of minitouch-bench"
                )
            with cache_errors(folder):
                folder.mkdir(parents=True, exist_ok=True)
                for name, content in files.contents.items():
                    replace_file(folder / name, content)
        return folder / names[1]

    def record(self) -> bytes:
        """Return the record from the pack, verified.

        Raises:
            UsageError: it is not what the manifest says.
        """
        try:
            with self.pack.open("rb") as file:
                file.seek(int(self.entry["offset"]))
                record = file.read(int(self.entry["length"]))
        except OSError as error:
            raise UsageError(f"{self.pack} cannot be read: {error.strerror}") from error
        if digest(record) != self.digest:
            raise UsageError(f"{self.name}: its bytes in {self.pack} do not match the manifest")
        return record

    def body(self) -> Body:
        """Return geometry, mass and inertia."""
        return decode(self.record())


@dataclass(frozen=True)
class ShapeSet:
    """A set of shapes. ``digest`` is the SHA-256 over the manifest's content."""

    name: str
    digest: str
    shapes: tuple[Shape, ...]
    document: Mapping[str, Any]
    path: Path

    def split(self, name: str) -> tuple[Shape, ...]:
        """Return the shapes of "train" or "held-out".

        Raises:
            UsageError: there is no such split.
        """
        found = tuple(shape for shape in self.shapes if shape.split == name)
        if not found:
            raise UsageError(f"shape set '{self.name}' has no split '{name}': train or held-out")
        return found

    def by_name(self, name: str) -> Shape:
        """Return one shape.

        Raises:
            UsageError: there is none of that name.
        """
        for shape in self.shapes:
            if shape.name == name:
                return shape
        raise UsageError(f"shape set '{self.name}' has no shape '{name}'")


def content_digest(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a manifest's content, whatever its spacing."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def load_shape_set(path: Path | str) -> ShapeSet:
    """Read a shape set; its records are verified when they are first used.

    Raises:
        UsageError: the folder holds no shape set, or one that is damaged or too new.
    """
    folder = Path(path).absolute()
    try:
        document = json.loads(read_file(folder / MANIFEST, GIB, follow=True))
    except FileNotFoundError as error:
        raise UsageError(f"{folder} holds no shape set: {MANIFEST} is missing") from error
    except (OSError, ValueError) as error:
        raise UsageError(f"{folder / MANIFEST} cannot be read: {error}") from error
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise UsageError(f"{folder / MANIFEST} is not of schema {SCHEMA}")
    try:
        shapes = tuple(_shape(entry, folder / PACK) for entry in document["shapes"])
        name = str(document["name"])
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(f"{folder / MANIFEST} is damaged: {error!r}") from error
    return ShapeSet(name, content_digest(document), shapes, document, folder)


@lru_cache(maxsize=1)
def canonical_shape_set() -> ShapeSet:
    """Return the set every official run uses: 1000 shapes, 800 to train on, 200 held out.

    Raises:
        UsageError: the installation lacks it.
    """
    for folder in canonical_places():
        if (folder / MANIFEST).is_file():
            return load_shape_set(folder)
    raise UsageError(f"the shape set {CANONICAL} is not installed; reinstall minitouch-bench")


def canonical_places() -> tuple[Path, ...]:
    """Return where the canonical set may be: top level of a checkout, then inside the wheel."""
    package = Path(__file__).resolve().parent
    return (
        package.parent.parent / "shapes" / CANONICAL,
        package.parent / "shapes" / CANONICAL,
    )


def _shape(entry: Mapping[str, Any], pack: Path) -> Shape:
    x, y, z = (float(side) for side in entry["extents_m"])
    poses = tuple(_pose(pose) for pose in entry["poses"])
    return Shape(
        name=str(entry["name"]),
        family=str(entry["family"]),
        split=str(entry["split"]),
        mass=float(entry["mass_kg"]),
        extents=(x, y, z),
        poses=poses,
        digest=str(entry["sha256"]),
        entry=entry,
        pack=pack,
    )


def _pose(pose: Mapping[str, Any]) -> RestPose:
    x, y, z, w = (float(number) for number in pose["quaternion"])
    return RestPose((x, y, z, w), float(pose["height_m"]), float(pose["probability"]))


def _hash_of(folder: Path, names: tuple[str, ...]) -> str:
    """Return the digest over files in the order of their names, "" if one is missing."""
    sha = hashlib.sha256()
    try:
        for name in sorted(names):
            sha.update(read_file(folder / name, MIB))
    except OSError:
        return ""
    return sha.hexdigest()
