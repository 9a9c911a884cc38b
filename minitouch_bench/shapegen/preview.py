"""Pictures of a set: contact sheets by family and split, and one page to browse it offline."""

import base64
import io
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
from jinja2 import Template
from PIL import Image, ImageDraw

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.files import os_errors_as, replace_file
from minitouch_bench.protocol.spec import CameraSpec, Split
from minitouch_bench.shapegen.manifest import Shape, ShapeSet
from minitouch_bench.shapegen.mesh import product, yaw
from minitouch_bench.simulation.client import PhysicsClient, View

Progress = Callable[[int, int], None]

TEMPLATE = Path(__file__).with_name("preview.html.j2")
TILE = 120
"""Side of one picture in pixels; it is rendered at twice that and averaged."""
COLUMNS = 12
CAMERA = CameraSpec(
    (0.0, 0.0, 0.0), -110.0, -32.0, near=0.05, distance=0.33, field_of_view=20.0, far=1.0
)
TRAIN_COLOR = (0.36, 0.58, 0.82, 1.0)
HELD_OUT_COLOR = (0.93, 0.58, 0.26, 1.0)


def preview(shapes: ShapeSet, folder: Path, progress: Progress = lambda *_: None) -> list[Path]:
    """Write one sheet per family and split, then ``index.html`` with every shape.

    Raises:
        InfrastructureError: the folder cannot be written.
    """
    pictures: dict[str, Image.Image] = {}
    with closing(PhysicsClient()) as client:
        for done, shape in enumerate(shapes.shapes, start=1):
            pictures[shape.name] = _picture(client, shape)
            progress(done, len(shapes.shapes))
    written = []
    with os_errors_as(InfrastructureError, folder, "written"):
        folder.mkdir(parents=True, exist_ok=True)
        for family, split in sorted({(shape.family, shape.split) for shape in shapes.shapes}):
            chosen = [s for s in shapes.shapes if (s.family, s.split) == (family, split)]
            written.append(folder / f"{family}-{split}.png")
            sheet = _sheet(chosen, pictures, f"{family}, {split}: {len(chosen)}")
            replace_file(written[-1], _png(sheet))
        page = folder / "index.html"
        replace_file(page, _page(shapes, pictures).encode())
    return [*written, page]


def _picture(client: PhysicsClient, shape: Shape) -> Image.Image:
    """Render a shape in its likeliest pose, turned a little, TILE x TILE pixels."""
    client.reset_world()
    turned = product(yaw(0.5), shape.poses[0].quaternion)
    body = client.load_urdf(shape.urdf, orientation=turned)
    client.paint({(body, -1): HELD_OUT_COLOR if shape.split == Split.HELD_OUT else TRAIN_COLOR})
    image = client.render(View.of(CAMERA), 2 * TILE, 2 * TILE, bodies=True)
    assert image.bodies is not None
    on_white = np.where(image.bodies[..., None] >= 0, image.rgb, np.uint8(255))
    return Image.fromarray(on_white).reduce(2)


def _sheet(shapes: Sequence[Shape], pictures: dict[str, Image.Image], title: str) -> Image.Image:
    rows = -(-len(shapes) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * TILE, 24 + rows * (TILE + 12)), "white")
    draw = ImageDraw.Draw(sheet)
    draw.text((8, 6), title, fill="black")
    for number, shape in enumerate(shapes):
        x, y = number % COLUMNS * TILE, 24 + number // COLUMNS * (TILE + 12)
        sheet.paste(pictures[shape.name], (x, y))
        label = f"{shape.name.rpartition('-')[2]}  {shape.mass * 1000:.0f} g"
        draw.text((x + 8, y + TILE - 2), label, fill=(120, 120, 120))
    return sheet


def _page(shapes: ShapeSet, pictures: dict[str, Image.Image]) -> str:
    template = Template(TEMPLATE.read_text("utf-8"), autoescape=True)
    encoded = {
        name: base64.b64encode(_png(picture.quantize(48))).decode()
        for name, picture in pictures.items()
    }
    families = sorted({shape.family for shape in shapes.shapes})
    return str(template.render(shapes=shapes, families=families, pictures=encoded))


def _png(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
