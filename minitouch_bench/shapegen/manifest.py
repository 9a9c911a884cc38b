"""Shape sets: read one, verify it, and hand out its shapes as files a simulator loads.

A set is a folder with ``manifest.json`` and ``shapes.bin``, the records one after another. Its
split holds out one fifth, evenly over families, chosen by hash and by nobody.
"""

import hashlib
import json
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from minitouch_bench.errors import UsageError
from minitouch_bench.files import GIB, MIB, cache_directory, cache_errors, read_file, replace_file
from minitouch_bench.protocol.spec import Split, content_digest
from minitouch_bench.shapegen.body_codec import (
    Body,
    body_files,
    decode,
    digest,
    file_names,
    files_stem,
)
from minitouch_bench.shapegen.mesh import RestPose

MANIFEST = "manifest.json"
PACK = "shapes.bin"
SCHEMA = "minitouch-shapes-1"
CANONICAL = "minitouch-1000"
CANONICAL_SEED, CANONICAL_COUNT = 0, 1000

HELD_OUT_SHARE = 0.2
PLAIN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,199}")
"""A shape's name and its family are names of files too."""
MEASURED = ("genus", "misfit", "outside_m", "wall_m", "convexity", "volume_m3", "density", "lifted")
"""What the manifest tells of a shape beyond what its record holds."""
COUNTED = ("hulls", "faces", "hull_vertices")
SALT = "minitouch split 1"
GROUP = 5
"""Of so many shapes of a family in a row one is held out, outside the canonical set."""


@dataclass(frozen=True)
class Shape:
    """One object of a set. ``mass`` in kg, ``extents`` (its sides along its own axes) in m.

    ``poses``: the ways it lies on a table: the one in which the tasks lay it down, then the
    others, likeliest first; the height is that of the center
    of mass, which is the origin of its frame. ``digest`` is the SHA-256 of its record,
    ``files_sha256`` that of its meshes and URDF.
    ``entry`` is everything the manifest says about it.
    """

    name: str
    family: str
    split: str
    mass: float
    extents: tuple[float, float, float]
    poses: tuple[RestPose, ...]
    digest: str
    files_sha256: str
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
        names = file_names(files_stem(self.digest))
        folder = cache_directory() / "shapes" / self.digest[:2]
        if _digest_of(folder, names) != self.files_sha256:
            files = body_files(self.body())
            if digest(*files.values()) != self.files_sha256:
                raise UsageError(
                    f"shape {self.digest[:20]}: its files differ from the manifest's; "
                    "the set was made by another version of minitouch-bench"
                )
            with cache_errors(folder):
                folder.mkdir(parents=True, exist_ok=True)
                for name, content in files.items():
                    replace_file(folder / name, content)
        return folder / names[-1]

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
        shapes = tuple(shape for shape in self.shapes if shape.split == name)
        if not shapes:
            known = ", ".join(sorted({shape.split for shape in self.shapes}))
            raise UsageError(f"shape set '{self.name}' has no split '{name}'; it has {known}")
        return shapes

    def by_name(self, name: str) -> Shape:
        """Return one shape.

        Raises:
            UsageError: there is none of that name.
        """
        for shape in self.shapes:
            if shape.name == name:
                return shape
        raise UsageError(f"shape set '{self.name}' has no shape '{name}'")


def load_shape_set(path: Path | str) -> ShapeSet:
    """Read a shape set; its records are verified when they are first used.

    Raises:
        UsageError: the folder contains no shape set, or one that is damaged or too new.
    """
    folder = Path(path).absolute()
    try:
        document = json.loads(read_file(folder / MANIFEST, GIB, follow=True))
    except FileNotFoundError as error:
        raise UsageError(f"{folder} contains no shape set: {MANIFEST} is missing") from error
    except (OSError, ValueError, RecursionError) as error:
        raise UsageError(f"{folder / MANIFEST} cannot be read: {error}") from error
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise UsageError(f"{folder / MANIFEST} is not of schema {SCHEMA}")
    try:
        shapes = tuple(_shape(entry, folder / PACK) for entry in document["shapes"])
        if not shapes:
            raise ValueError("it lists no shapes")
        for key, kind in (("name", str), ("count", int), ("pack_sha256", str)):
            if type(document[key]) is not kind:
                raise ValueError(f"its {key} is no {kind.__name__}")
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise UsageError(f"{folder / MANIFEST} is damaged: {error!r}") from error
    return ShapeSet(document["name"], content_digest(document), shapes, document, folder)


@lru_cache(maxsize=1)
def canonical_shape_set() -> ShapeSet:
    """Return the set every official run uses: 1000 shapes, 800 to train on, 200 held out.

    Raises:
        UsageError: the installation lacks it.
    """
    package = Path(__file__).resolve().parent.parent
    for place in (package.parent, package):  # the top level of a checkout; the wheel
        folder = place / "shapes" / CANONICAL
        if (folder / MANIFEST).is_file():
            return load_shape_set(folder)
    raise UsageError(f"the shape set {CANONICAL} is not installed; reinstall minitouch-bench")


def _shape(entry: Mapping[str, Any], pack: Path) -> Shape:
    for key in ("name", "family"):
        if not PLAIN_NAME.fullmatch(str(entry[key])):
            raise ValueError(f"{str(entry[key])[:80]!a} is no plain {key}")
    if entry["split"] not in [*Split]:
        raise ValueError(f"{str(entry['split'])[:80]!a} is no split")
    for key in ("offset", "length", *COUNTED):
        if type(entry[key]) is not int or not 0 <= entry[key] <= GIB:
            raise ValueError(f"its {key} is no number of them")
    for key in MEASURED:
        if type(entry[key]) not in (int, float) or not math.isfinite(entry[key]):
            raise ValueError(f"its {key} is no number")
    x, y, z = (float(side) for side in entry["extents_m"])
    poses = tuple(read_pose(pose) for pose in entry["poses"])
    if not poses:
        raise ValueError(f"{entry['name']} has no poses")
    return Shape(
        name=str(entry["name"]),
        family=str(entry["family"]),
        split=str(entry["split"]),
        mass=float(entry["mass_kg"]),
        extents=(x, y, z),
        poses=poses,
        digest=str(entry["sha256"]),
        files_sha256=str(entry["files_sha256"]),
        entry=entry,
        pack=pack,
    )


def read_pose(pose: Mapping[str, Any]) -> RestPose:
    """Return a pose of a manifest's entry.

    Raises:
        KeyError, TypeError, ValueError, OverflowError: it is damaged.
    """
    x, y, z, w = (float(number) for number in pose["quaternion"])
    return RestPose((x, y, z, w), float(pose["height_m"]), float(pose["probability"]))


def _digest_of(folder: Path, names: tuple[str, ...]) -> str:
    """Return the digest over files, "" if one is missing."""
    try:
        return digest(*(read_file(folder / name, MIB) for name in names))
    except OSError:
        return ""


def splits_of(seed: int | None, families: Sequence[str], digests: Sequence[str]) -> tuple[str, ...]:
    """Return the split of every shape of a set generated with a seed, or imported (None).

    A generated shape has the split of its number, whatever the set's size: nothing that the
    canonical set holds out is ever trained on in a smaller or larger one.
    """
    if seed is None:
        return split_by_hash(families, digests)
    first = _canonical_splits(families, digests) if seed == CANONICAL_SEED else ()
    return first + tuple(_numbered_splits(seed, families))[len(first) :]


def split_by_hash(families: Sequence[str], digests: Sequence[str]) -> tuple[str, ...]:
    """Return the split of every shape of a whole set from its record's digest.

    In each family the fifth whose salted hash is lowest is held out.
    """
    held: set[int] = set()
    for name in set(families):
        members = [i for i, family in enumerate(families) if family == name]
        members.sort(key=lambda i: _hash(digests[i]))
        held.update(members[: round(len(members) * HELD_OUT_SHARE)])
    return tuple(Split.HELD_OUT if i in held else Split.TRAIN for i in range(len(families)))


def _canonical_splits(families: Sequence[str], digests: Sequence[str]) -> tuple[str, ...]:
    """Return the splits of the first thousand shapes, or of as many as there are."""
    if len(digests) >= CANONICAL_COUNT:
        return split_by_hash(families[:CANONICAL_COUNT], digests[:CANONICAL_COUNT])
    return tuple(shape.split for shape in canonical_shape_set().shapes[: len(digests)])


def _numbered_splits(seed: int, families: Sequence[str]) -> Iterator[str]:
    """Yield the split of every shape by its number: one in each five of a family is held out."""
    seen: Counter[str] = Counter()
    for family in families:
        group, turn = divmod(seen[family], GROUP)
        chosen = int(_hash(f"{seed}/{family}/{group}"), 16) % GROUP
        yield Split.HELD_OUT if turn == chosen else Split.TRAIN
        seen[family] += 1


def _hash(text: str) -> str:
    return hashlib.sha256(f"{SALT}/{text}".encode()).hexdigest()
