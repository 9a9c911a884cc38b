"""Check a shape set against its manifest, and write a page with a picture of each shape."""

import base64
import io
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Template
from PIL import Image

from minitouch_bench.errors import InfrastructureError, UsageError
from minitouch_bench.files import GIB, os_errors_as, read_file, replace_file
from minitouch_bench.processes import run_in_workers
from minitouch_bench.protocol.spec import CameraSpec, Split
from minitouch_bench.shapegen.body_codec import Body, decode, digest
from minitouch_bench.shapegen.generate import Progress, record_facts
from minitouch_bench.shapegen.geometry import RestPose, product, yaw
from minitouch_bench.shapegen.manifest import Shape, ShapeSet, splits_of
from minitouch_bench.shapegen.soundness import LIMITS, UnsoundError, check_body, strictly
from minitouch_bench.simulation.client import PhysicsClient, View

MEASURED = ("genus", "misfit", "outside_m", "wall_m", "convexity", "volume_m3", "density", "lifted")
"""What the manifest tells of a shape beyond what its record holds."""
PROCESSOR_TOLERANCE: Mapping[str, float] = {"lifted": 1.0 / LIMITS.yaws, "volume_m3": 0.0}
"""By how much another processor may measure otherwise beside 0.1 %: one grip trial; others 2e-5."""
POSE_ROUNDING = (1e-4, *[0.01] * 10)
"""The same for a pose: height (m), share, and the nine numbers of the rotation matrix."""


def check_set(
    shapes: ShapeSet, workers: int = 1, quick: bool = False, progress: Progress = lambda *_: None
) -> tuple[str, ...]:
    """Return the problems of a set; ``quick`` leaves out the proofs in the simulator."""
    problems = [*_pack_problems(shapes), *_manifest_problems(shapes)]
    bodies: dict[int, Body] = {}
    for position, shape in enumerate(shapes.shapes):
        try:
            bodies[position] = shape.body()
        except UsageError as error:
            text = str(error)
            problems.append(text if text.startswith(shape.name) else f"{shape.name}: {text}")
            continue
        problems += _number_problems(shapes.document["shapes"][position], bodies[position])
    if not quick:
        problems += _unsound(shapes, bodies, workers, progress)
    return tuple(problems)


def _is_imported(shapes: ShapeSet) -> bool:
    return "imported" in shapes.document


def _pack_problems(shapes: ShapeSet) -> Iterator[str]:
    try:
        pack = read_file(shapes.shapes[0].pack, GIB, follow=True)
    except OSError as error:
        yield f"the pack cannot be read: {error}"
        return
    if digest(pack) != shapes.document["pack_sha256"]:
        yield "the pack's SHA-256 is not the manifest's"


def _manifest_problems(shapes: ShapeSet) -> Iterator[str]:
    listed = shapes.shapes
    if len(listed) != shapes.document["count"]:
        yield f"{len(listed)} shapes are listed, the count says {shapes.document['count']}"
    for name, number in Counter(shape.name for shape in listed).items():
        if number > 1:
            yield f"{name} is listed {number} times"
    first: dict[str, str] = {}
    for shape in () if _is_imported(shapes) else listed:  # the copies among a user's are listed so
        if shape.digest in first:
            yield f"{shape.name} is a copy of {first[shape.digest]}"
        first.setdefault(shape.digest, shape.name)
    families = [shape.family for shape in listed]
    digests = [shape.digest for shape in listed]
    rule = splits_of(shapes.document.get("seed"), families, digests)
    for shape, split in zip(listed, rule, strict=True):
        if shape.split != split:
            yield f"{shape.name} is marked {shape.split}, the rule says {split}"


def _number_problems(listed: Mapping[str, Any], body: Body) -> Iterator[str]:
    if not np.isfinite([body.mass, *body.inertia, *listed["extents_m"]]).all():
        yield f"{listed['name']}: a mass, moment or extent is not a finite number"
        return
    for key, found in record_facts(body).items():
        if listed[key] != found:
            yield f"{listed['name']}: {key} is {listed[key]} in the manifest, {found} in the record"


def _unsound(
    shapes: ShapeSet, bodies: dict[int, Body], workers: int, progress: Progress
) -> Iterator[str]:
    """Yield the shapes that fail a criterion, or measure otherwise than the manifest says."""
    order = sorted(bodies)
    tasks = [(shapes.shapes[position].record(), _is_imported(shapes)) for position in order]
    verdicts: dict[int, tuple[str, Any]] = {}
    for task, verdict in run_in_workers(examine_record, tasks, workers, name=lambda _: "a proof"):
        verdicts[order[task]] = verdict
        progress(len(verdicts), len(order))
    for position in order:
        shape, (reason, measured) = shapes.shapes[position], verdicts[position]
        if reason:
            yield f"{shape.name}: {reason}"
        for key in (*MEASURED, "poses") if measured else ():
            listed = getattr(shape, key)
            if not _close(key, measured[key], listed):
                yield f"{shape.name}: {key} measures {measured[key]}, not {listed}"


def _close(key: str, measured: Any, listed: Any) -> bool:
    """Say whether two measurements agree but for the rounding of another processor."""
    if key == "poses":
        ours, theirs = ([_numbers(pose) for pose in poses] for poses in (measured, listed))
        return len(ours) == len(theirs) and np.allclose(ours, theirs, rtol=0.0, atol=POSE_ROUNDING)
    return bool(np.isclose(measured, listed, rtol=1e-3, atol=PROCESSOR_TOLERANCE.get(key, 2e-5)))


def _numbers(pose: RestPose) -> list[float]:
    """Return the numbers of a pose: its rotation as a matrix, in which q and -q are equal."""
    return [pose.height, pose.probability, *pose.rotation.ravel().tolist()]


def examine_record(task: tuple[bytes, bool]) -> tuple[str, dict[str, Any]]:
    """Return the reason a record's body is unsound ("" if none) and its measures.

    Of an imported one the sizes, poses and grips are measured only.
    """
    record, is_imported = task
    body = decode(record)
    try:
        measures = check_body(body, (lambda *_: None) if is_imported else strictly)
    except UnsoundError as error:
        return str(error), {}
    return "", {**measures, "density": body.mass / measures["volume_m3"]}


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
    image = client.render(View.of(CAMERA), 2 * TILE, 2 * TILE, bodies=True)
    on_white = np.where(image.bodies[..., None] >= 0, image.rgb, np.uint8(255))
    buffer = io.BytesIO()
    Image.fromarray(on_white).reduce(2).quantize(48).save(buffer, "PNG", optimize=True)
    return base64.b64encode(buffer.getvalue()).decode()
