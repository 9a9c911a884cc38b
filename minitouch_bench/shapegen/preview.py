"""Pictures of a set: contact sheets by family and split, and one page to browse it offline."""

import base64
import html
import io
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.files import os_errors_as, replace_file
from minitouch_bench.protocol.spec import CameraSpec
from minitouch_bench.shapegen.manifest import HELD_OUT, Shape, ShapeSet
from minitouch_bench.shapegen.poses import product, yaw
from minitouch_bench.simulation.bullet import View
from minitouch_bench.simulation.client import PhysicsClient

Picture = NDArray[np.uint8]
Progress = Callable[[int, int], None]

TILE = 120
"""Side of one picture in pixels; it is rendered at twice that and averaged."""
COLUMNS = 12
CAMERA = CameraSpec(
    (0.0, 0.0, 0.0), -110.0, -32.0, near=0.05, distance=0.24, field_of_view=20.0, far=1.0
)
TRAIN_COLOR = (0.36, 0.58, 0.82, 1.0)
HELD_OUT_COLOR = (0.93, 0.58, 0.26, 1.0)


def preview(shapes: ShapeSet, folder: Path, progress: Progress = lambda *_: None) -> list[Path]:
    """Write one sheet per family and split, then ``index.html`` with every shape.

    Raises:
        InfrastructureError: the folder cannot be written.
    """
    pictures: dict[str, Picture] = {}
    with closing(PhysicsClient()) as client:
        for done, shape in enumerate(shapes.shapes, start=1):
            pictures[shape.name] = _picture(client, shape)
            progress(done, len(shapes.shapes))
    written = []
    with os_errors_as(InfrastructureError, folder, "written"):
        folder.mkdir(parents=True, exist_ok=True)
        for family in sorted({shape.family for shape in shapes.shapes}):
            for split in sorted({shape.split for shape in shapes.shapes}):
                chosen = [s for s in shapes.shapes if (s.family, s.split) == (family, split)]
                if chosen:
                    path = folder / f"{family}-{split}.png"
                    title = f"{family}, {split}: {len(chosen)}"
                    replace_file(path, _png(_sheet(chosen, pictures, title)))
                    written.append(path)
        page = folder / "index.html"
        replace_file(page, _page(shapes, pictures).encode())
    return [*written, page]


def _picture(client: PhysicsClient, shape: Shape) -> Picture:
    """Render a shape in its likeliest pose, turned a little; uint8 (TILE, TILE, 3)."""
    client.reset_world()
    turned = product(yaw(0.5), shape.poses[0].quaternion)
    body = client.load_urdf(shape.urdf, orientation=turned)
    client.paint({(body, -1): HELD_OUT_COLOR if shape.split == HELD_OUT else TRAIN_COLOR})
    side = 2 * TILE
    found = client.render(View.of(CAMERA), side, side, bodies=True)
    assert found.bodies is not None
    image = np.where(found.bodies[..., None] >= 0, found.rgb, 255).astype(np.float64)
    averaged: Picture = (
        image.reshape(TILE, 2, TILE, 2, 3).mean(axis=(1, 3)).round().astype(np.uint8)
    )
    return averaged


def _sheet(shapes: Sequence[Shape], pictures: dict[str, Picture], title: str) -> Image.Image:
    """Return a contact sheet with a title above and a number under each picture."""
    rows = -(-len(shapes) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * TILE, 24 + rows * (TILE + 12)), "white")
    draw = ImageDraw.Draw(sheet)
    draw.text((8, 6), title, fill="black")
    for number, shape in enumerate(shapes):
        x, y = number % COLUMNS * TILE, 24 + number // COLUMNS * (TILE + 12)
        sheet.paste(Image.fromarray(pictures[shape.name]), (x, y))
        label = f"{shape.name.rpartition('-')[2]}  {shape.mass * 1000:.0f} g"
        draw.text((x + 8, y + TILE - 2), label, fill=(120, 120, 120))
    return sheet


_STYLE = """body{font:14px/1.4 system-ui,sans-serif;margin:1.5rem;color:#222;background:#fff}
main{display:flex;flex-wrap:wrap;gap:6px}figure{margin:0;width:120px;text-align:center}
figcaption{font-size:11px;color:#555}img{width:120px;height:120px}
label,select,input{margin-right:.8rem}"""
_SCRIPT = """const all=[...document.querySelectorAll('figure')];
function show(){const f=family.value,s=split.value,t=text.value;let n=0;
for(const e of all){const ok=(!f||e.dataset.family===f)&&(!s||e.dataset.split===s)&&
e.title.includes(t);e.hidden=!ok;e.style.display=ok?'':'none';n+=ok}
count.textContent=n+' shapes'}
for(const e of[family,split,text])e.addEventListener('input',show);show()"""


def _page(shapes: ShapeSet, pictures: dict[str, Picture]) -> str:
    """Return one self-contained page: filters above, a picture and its numbers for each shape."""
    families = sorted({shape.family for shape in shapes.shapes})
    options = "".join(f"<option>{html.escape(name)}</option>" for name in families)
    figures = "".join(_figure(shape, pictures[shape.name]) for shape in shapes.shapes)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(shapes.name)}'
        f"</title><style>{_STYLE}</style><h1>{html.escape(shapes.name)}</h1>"
        f"<p>digest {shapes.digest}</p><p><label>family <select id=family><option value=''>all"
        f"</option>{options}</select></label><label>split <select id=split><option value=''>both"
        "</option><option>train</option><option>held-out</option></select></label>"
        "<label>name <input id=text></label><b id=count></b></p>"
        f"<main>{figures}</main><script>{_SCRIPT}</script></html>\n"
    )


def _figure(shape: Shape, picture: Picture) -> str:
    data = base64.b64encode(_png(Image.fromarray(picture).quantize(48))).decode()
    sides = " x ".join(f"{side * 1000:.0f}" for side in shape.extents)
    name = html.escape(shape.name)
    return (
        f'<figure data-family="{html.escape(shape.family)}" data-split="{shape.split}" '
        f'title="{name}"><img alt="{name}" src="data:image/png;base64,{data}"><figcaption>{name}'
        f"<br>{shape.mass * 1000:.0f} g, {shape.entry['hulls']} hulls<br>{sides} mm</figcaption>"
        "</figure>"
    )


def _png(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
