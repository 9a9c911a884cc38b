"""Check a shape set against its manifest, and draw its shapes on a page."""

import base64
import io
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Template
from PIL import Image

from minitouch_bench.errors import InfrastructureError, UsageError
from minitouch_bench.files import GIB, os_errors_as, read_file, replace_file
from minitouch_bench.processes import run_in_workers
from minitouch_bench.protocol.spec import CameraSpec, Split
from minitouch_bench.shapegen.body_codec import digest
from minitouch_bench.shapegen.generate import Progress, record_facts
from minitouch_bench.shapegen.geometry import RestPose, product, yaw
from minitouch_bench.shapegen.manifest import Shape, ShapeSet, splits_of
from minitouch_bench.shapegen.soundness import LIMITS, UnsoundError, check_body, strictly
from minitouch_bench.simulation.client import PhysicsClient

PROCESSOR_TOLERANCE: Mapping[str, float] = {"lifted": 1.0 / LIMITS.yaws, "volume_m3": 0.0}
"""Absolute tolerance by key on another processor, in addition to 0.1 %. Keys not listed: 2e-5."""
POSE_ROUNDING = (1e-4, *[0.01] * 10)
"""Absolute tolerance of a pose: height (m), share, and the nine numbers of the rotation matrix."""


def check_set(
    shapes: ShapeSet, workers: int = 1, quick: bool = False, progress: Progress = lambda *_: None
) -> tuple[str, ...]:
    """Return the problems of a set; ``quick`` leaves out the proofs in the simulator."""
    examine = partial(examine_shape, is_imported=_is_imported(shapes), quick=quick)
    jobs = [*zip(shapes.shapes, shapes.document["shapes"], strict=True)]
    found: dict[int, tuple[str, ...]] = {}
    for place, problems in run_in_workers(examine, jobs, workers, name=lambda job: job[0].name):
        found[place] = problems
        progress(len(found), len(jobs))
    return (
        *_manifest_problems(shapes),
        *(text for place in sorted(found) for text in found[place]),
    )


def _is_imported(shapes: ShapeSet) -> bool:
    return "imported" in shapes.document


def _manifest_problems(shapes: ShapeSet) -> Iterator[str]:
    listed, document = shapes.shapes, shapes.document
    with suppress(OSError):  # each shape that cannot be read is a problem of its own
        if digest(read_file(listed[0].pack, GIB, follow=True)) != document["pack_sha256"]:
            yield "the pack's SHA-256 is not the manifest's"
    if len(listed) != document["count"]:
        yield f"{len(listed)} shapes are listed, the count says {document['count']}"
    for name, number in Counter(shape.name for shape in listed).items():
        if number > 1:
            yield f"{name} is listed {number} times"
    digests = [shape.digest for shape in listed]
    if not _is_imported(shapes):  # the copies among a user's are listed as such
        for shape in listed:
            if (first := listed[digests.index(shape.digest)]) is not shape:
                yield f"{shape.name} is a copy of {first.name}"
    rule = splits_of(document.get("seed"), [shape.family for shape in listed], digests)
    for shape, split in zip(listed, rule, strict=True):
        if shape.split != split:
            yield f"{shape.name} is marked {shape.split}, the rule says {split}"


def _close(key: str, measured: Any, listed: Any) -> bool:
    """Say whether two measurements agree but for the rounding of another processor."""
    if key == "poses":
        ours, theirs = ([_numbers(pose) for pose in poses] for poses in (measured, listed))
        return len(ours) == len(theirs) and np.allclose(ours, theirs, rtol=0.0, atol=POSE_ROUNDING)
    return bool(np.isclose(measured, listed, rtol=1e-3, atol=PROCESSOR_TOLERANCE.get(key, 2e-5)))


def _numbers(pose: RestPose) -> list[float]:
    """Return the numbers of a pose: its rotation as a matrix, in which q and -q are equal."""
    return [pose.height, pose.probability, *pose.rotation.ravel().tolist()]


def examine_shape(
    job: tuple[Shape, Mapping[str, Any]], *, is_imported: bool, quick: bool
) -> tuple[str, ...]:
    """Return in what a shape is unsound or differs from its entry in the manifest.

    Of an imported one the sizes, poses and grips are measured only.
    """
    (shape, listed), problems = job, list[str]()
    try:
        body = shape.body()
        for key, found in record_facts(body).items():
            if listed[key] != found:
                problems.append(f"{key} is {listed[key]} in the manifest, {found} in the record")
        if not quick:
            measured = check_body(body, (lambda *_: None) if is_imported else strictly)
            measured["density"] = body.mass / measured["volume_m3"]
            for key, found in measured.items():
                if not _close(key, found, getattr(shape, key)):
                    problems.append(f"{key} measures {found}, not {getattr(shape, key)}")
    except (UsageError, UnsoundError) as error:
        problems.append(str(error))
    return tuple(f"{shape.name}: {problem}" for problem in problems)


TEMPLATE = Path(__file__).with_name("preview.html.j2")
TILE = 120
"""Side of one picture in pixels; it is rendered at twice that and averaged."""
CAMERA = CameraSpec(
    (0.0, 0.0, 0.0), -110.0, -32.0, near=0.05, distance=0.33, field_of_view=20.0, far=1.0
)
TRAIN_COLOR = (0.36, 0.58, 0.82, 1.0)
HELD_OUT_COLOR = (0.93, 0.58, 0.26, 1.0)


def preview(shapes: ShapeSet, folder: Path, progress: Progress = lambda *_: None) -> Path:
    """Write ``index.html``, and return its path.

    Raises:
        InfrastructureError: the folder cannot be written.
    """
    pictures: dict[str, str] = {}
    with closing(PhysicsClient()) as client:
        for done, shape in enumerate(shapes.shapes, start=1):
            pictures[shape.name] = _picture(client, shape)
            progress(done, len(shapes.shapes))
    families = sorted({shape.family for shape in shapes.shapes})
    template = Template(TEMPLATE.read_text("utf-8"), autoescape=True)
    page = template.render(shapes=shapes, families=families, pictures=pictures)
    with os_errors_as(InfrastructureError, folder, "written"):
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(folder / "index.html", page.encode())
    return folder / "index.html"


def _picture(client: PhysicsClient, shape: Shape) -> str:
    """Render a shape in its likeliest pose, turned a little; return a PNG in base64."""
    client.reset_world()
    turned = product(yaw(0.5), shape.poses[0].quaternion)
    body = client.load_urdf(shape.urdf, orientation=turned)
    client.paint({(body, -1): HELD_OUT_COLOR if shape.split == Split.HELD_OUT else TRAIN_COLOR})
    image = client.render(CAMERA, 2 * TILE, 2 * TILE, bodies=True)
    on_white = np.where(image.bodies[..., None] >= 0, image.rgb, np.uint8(255))
    buffer = io.BytesIO()
    Image.fromarray(on_white).reduce(2).quantize(48).save(buffer, "PNG", optimize=True)
    return base64.b64encode(buffer.getvalue()).decode()
