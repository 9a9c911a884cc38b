"""One page with a picture of every shape of a set, to browse it offline."""

import base64
import io
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
from jinja2 import Template
from PIL import Image

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
