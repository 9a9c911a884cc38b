"""Shape sets: read one, verify it, and hand out its shapes as files a simulator loads.

A set is a folder with ``manifest.json`` and ``shapes.bin``, the records one after another. Its
split holds out one fifth, evenly over families, chosen by hash and by nobody.
"""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct, ValidationError, convert
from msgspec.structs import replace

from minitouch_bench import files
from minitouch_bench.errors import UsageError
from minitouch_bench.json_io import StrPath, fault_in_words, whole
from minitouch_bench.protocol.spec import CUBE, Split, content_digest
from minitouch_bench.shapegen import body_codec
from minitouch_bench.shapegen.geometry import RestPose

MANIFEST = "manifest.json"
PACK = "shapes.bin"
SCHEMA = "minitouch-shapes-1"
CANONICAL = "minitouch-1000"
CANONICAL_SEED, CANONICAL_COUNT = 0, 1000

HELD_OUT_SHARE = 0.2
SALT = "minitouch split 1"
PlainName = Annotated[str, Meta(pattern=whole(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,199}"))]
"""A shape's name and its family are names of files too."""
Size = Annotated[int, Meta(ge=0, le=files.GIB)]
KEYS = {"mass": "mass_kg", "extents": "extents_m", "digest": "sha256"}


class Shape(Struct, frozen=True, rename=KEYS):
    """One object of a set, as the manifest lists it.

    ``mass`` in kg, ``extents`` (its sides along its own axes) in m. ``poses``: the ways it lies
    on a table: the one in which the tasks lay it down, then the others, likeliest first; the
    height is that of the center of mass, which is the origin of its frame. ``digest`` is the
    SHA-256 of its record, ``files_sha256`` that of its meshes and URDF. An imported one has
    ``not_promised``, what it lacks of the promises of the canonical set, and ``sides_m`` along the
    axes of its file. The record is at ``offset`` in the file ``pack``. The others are what
    ``soundness.check_body`` says.
    """

    name: PlainName
    family: PlainName
    split: Split
    mass: float
    density: float
    extents: tuple[float, float, float]
    volume_m3: float
    convexity: float
    genus: int
    wall_m: float
    faces: Size
    hulls: Size
    hull_vertices: Size
    misfit: float
    outside_m: float
    lifted: float
    poses: Annotated[tuple[RestPose, ...], Meta(min_length=1)]
    digest: str
    files_sha256: str
    offset: Size
    length: Size
    not_promised: tuple[str, ...] = ()
    sides_m: tuple[float, float, float] | None = None
    pack: Path = Path()

    @property
    def urdf(self) -> Path:
        """Absolute path of its URDF in the cache, with its meshes beside it.

        A file that is not as the record gives it is written again, so a damaged one is never used.

        Raises:
            UsageError: the record is damaged, or does not give the files of the manifest.
            InfrastructureError: the cache cannot be written.
        """
        made = body_codec.body_files(self.body())
        if body_codec.digest(*made.values()) != self.files_sha256:
            raise UsageError(
                f"shape {self.digest[:20]}: its files differ from the manifest's; "
                "the set was made by another version of minitouch-bench"
            )
        folder = files.cache_directory() / "shapes" / self.digest[:2]
        with files.cache_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            for name, content in made.items():
                kept = b""
                with suppress(OSError):
                    kept = files.read_file(folder / name, files.MIB)
                if kept != content:
                    files.replace_file(folder / name, content)
        *_, urdf = made
        return folder / urdf

    def record(self) -> bytes:
        """Return the record from the pack, verified.

        Raises:
            UsageError: it is not what the manifest says.
        """
        try:
            with open(files.open_plain(self.pack, os.O_RDONLY, follow=True), "rb") as file:
                file.seek(self.offset)
                record = file.read(self.length)
        except OSError as error:
            raise UsageError(f"{self.pack} cannot be read: {error.strerror}") from error
        if body_codec.digest(record) != self.digest:
            raise UsageError(f"{self.pack}: the bytes of {self.name} are not the manifest's")
        return record

    def body(self) -> body_codec.Body:
        """Return geometry, mass and inertia.

        Raises:
            UsageError: the record is not what the manifest says, or a mesh in it is empty.
        """
        body = body_codec.decode(self.record())
        if not body.hulls or not all(mesh.faces.size for mesh in (body.visual, *body.hulls)):
            raise UsageError(f"{self.pack}: the record of {self.name} has an empty mesh")
        return body


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


Objects = StrPath | Sequence[str | Shape] | ShapeSet
"""What objects can be named by: "cube", a split, a set or its folder, or a list of shapes."""

ALL = "all"
"""The name of every shape of the canonical set."""

OF_THE_BENCHMARK = (CUBE, *Split, ALL)
"""Words for objects, which no folder of a shape set can have as its name."""


class _Manifest(Struct):
    name: str
    count: int
    pack_sha256: str
    shapes: Annotated[tuple[Shape, ...], Meta(min_length=1)]


def load_shape_set(path: Path | str) -> ShapeSet:
    """Read a shape set; its records are verified when they are first used.

    Raises:
        UsageError: the folder contains no shape set, or one that is damaged or too new.
    """
    folder = Path(path).absolute()
    manifest = folder / MANIFEST
    try:
        document = json.loads(files.read_file(manifest, files.LARGEST_FILE, follow=True))
    except FileNotFoundError as error:
        raise UsageError(
            f"{folder} contains no shape set: {MANIFEST} is missing. Make one of mesh files with "
            "minitouch-bench shapes import"
        ) from error
    except (OSError, ValueError, RecursionError) as error:
        raise UsageError(f"{manifest} cannot be read: {error}") from error
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise UsageError(f"{manifest} is not of schema {SCHEMA}")
    try:
        read = convert(document, _Manifest)
    except ValidationError as error:
        raise UsageError(f"{fault_in_words(error, str(manifest))}: it is damaged") from error
    shapes = tuple(replace(shape, pack=folder / PACK) for shape in read.shapes)
    return ShapeSet(read.name, content_digest(document), shapes, document, folder)


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


def choose_shapes(chosen: Objects) -> tuple[Shape, ...]:
    """Return the shapes of a split, of a whole set or its folder, or those listed.

    Raises:
        UsageError: there is no such split, set or shape, or none is listed.
    """
    if isinstance(chosen, ShapeSet):
        return chosen.shapes
    if isinstance(chosen, PathLike):
        return load_shape_set(Path(chosen)).shapes
    if isinstance(chosen, str):
        if chosen in (ALL, *Split):
            canonical = canonical_shape_set()
            return canonical.shapes if chosen == ALL else canonical.split(chosen)
        if not Path(chosen).is_dir():
            known = ", ".join(OF_THE_BENCHMARK)
            raise UsageError(
                f"no objects '{chosen}'; there are {known}, folders of shape sets, and in Python "
                "lists of shapes"
            )
        return load_shape_set(chosen).shapes
    if not chosen:
        raise UsageError("the list of objects is empty: name a shape")
    return tuple(
        item if isinstance(item, Shape) else canonical_shape_set().by_name(item) for item in chosen
    )


def splits_of(seed: int | None, families: Sequence[str], digests: Sequence[str]) -> tuple[str, ...]:
    """Return the split of every shape of a set generated with a seed, or imported (None).

    In each family the fifth whose salted hash is lowest is held out. A set of the canonical seed
    keeps the canonical splits: what they hold out is never trained on in a smaller or larger set.
    """
    salted = [hashlib.sha256(f"{SALT}/{digest}".encode()).hexdigest() for digest in digests]
    order = sorted(range(len(families)), key=salted.__getitem__)
    held: set[str] = set()
    for name in set(families):
        members = [digests[i] for i in order if families[i] == name]
        held.update(members[: round(len(members) * HELD_OUT_SHARE)])
    known = {digest: Split.HELD_OUT if digest in held else Split.TRAIN for digest in digests}
    if seed == CANONICAL_SEED and len(digests) != CANONICAL_COUNT:
        known |= {shape.digest: shape.split for shape in canonical_shape_set().shapes}
    return tuple(known[digest] for digest in digests)
