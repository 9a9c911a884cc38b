"""What a manifest says about a shape, and how records and entries become a set on disk."""

import json
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.files import os_errors_as, replace_file
from minitouch_bench.shapegen.manifest import MANIFEST, PACK, SCHEMA
from minitouch_bench.shapegen.poses import RestPose
from minitouch_bench.shapegen.record import Body, body_files, digest, encode
from minitouch_bench.shapegen.soundness import Measures
from minitouch_bench.shapegen.splits import splits_of

LIBRARIES = ("numpy", "coacd", "manifold3d", "fast-simplification", "pybullet")


def shape_name(index: int) -> str:
    """Return the name of shape number ``index``."""
    return f"shape-{index:04d}"


def entry_of(body: Body, measures: Measures, density: float, extra: Mapping[str, Any]) -> Any:
    """Return the manifest's entry of a body, without name, split and place in the pack.

    SI units; measures are rounded, mass and poses are not, since simulations start from them.
    """
    x, y, z = body.visual.extents.tolist()
    return {
        **extra,
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
        "files_sha256": body_files(body).sha256,
    }


def _pose(pose: RestPose) -> dict[str, Any]:
    return {
        "quaternion": list(pose.quaternion),
        "height_m": pose.height,
        "probability": round(pose.probability, 5),
    }


def versions() -> dict[str, str]:
    """Return the versions of everything a shape's bytes depend on."""
    return {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}}


def write_set(
    folder: Path, header: Mapping[str, Any], made: Sequence[tuple[Mapping[str, Any], bytes]]
) -> dict[str, Any]:
    """Write pack and manifest from entries and records in order; return the manifest.

    Raises:
        InfrastructureError: the folder cannot be written.
    """
    families = [entry["family"] for entry, _ in made]
    splits = splits_of(header.get("seed"), families, [digest(record) for _, record in made])
    shapes, offset = [], 0
    for (entry, record), split in zip(made, splits, strict=True):
        shapes.append({**entry, "split": split, "offset": offset, "length": len(record)})
        offset += len(record)
    pack = b"".join(record for _, record in made)
    document = {
        "schema": SCHEMA,
        **header,
        "versions": versions(),
        "count": len(shapes),
        "pack_sha256": digest(pack),
        "shapes": shapes,
    }
    with os_errors_as(InfrastructureError, folder, "written"):
        replace_file(folder / PACK, pack)
        replace_file(folder / MANIFEST, manifest_text(document).encode())
    return document


def manifest_text(document: Mapping[str, Any]) -> str:
    """Return a manifest with one line per shape, so that a difference can be read."""
    head = {key: value for key, value in document.items() if key != "shapes"}
    top = json.dumps(head, indent=1, allow_nan=False)[:-2]
    rows = ",\n".join(json.dumps(entry, allow_nan=False) for entry in document["shapes"])
    return f'{top},\n "shapes": [\n{rows}\n ]\n}}\n'
