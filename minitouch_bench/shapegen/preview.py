"""Pictures of a set: contact sheets by family and split, and one page to browse it offline."""

import base64
import html
import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pybullet
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.shapegen.manifest import Shape, ShapeSet
from minitouch_bench.shapegen.poses import product, yaw

Picture = NDArray[np.uint8]
Progress = Callable[[int, int], None]

TILE = 120
"""Side of one picture in pixels; it is rendered at twice that and averaged."""
COLUMNS = 12
CAMERA_DISTANCE = 0.24
TRAIN_COLOUR = (0.36, 0.58, 0.82, 1.0)
HELD_OUT_COLOUR = (0.93, 0.58, 0.26, 1.0)


@dataclass(frozen=True)
class PreviewFiles:
    """The pictures and the page that were written."""

    sheets: tuple[Path, ...]
    page: Path


def preview(shapes: ShapeSet, folder: Path, progress: Progress = lambda *_: None) -> PreviewFiles:
    """Write one sheet a family and split, and ``index.html`` with every shape.

    Raises:
        InfrastructureError: the folder cannot be written.
    """
    pictures: dict[str, Picture] = {}
    with _renderer() as client:
        for done, shape in enumerate(shapes.shapes, start=1):
            pictures[shape.name] = _picture(client, shape)
            progress(done, len(shapes.shapes))
    sheets = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for family in sorted({shape.family for shape in shapes.shapes}):
            for split in sorted({shape.split for shape in shapes.shapes}):
                chosen = [s for s in shapes.shapes if (s.family, s.split) == (family, split)]
                if chosen:
                    path = folder / f"{family}-{split}.png"
                    _sheet(chosen, pictures, f"{family}, {split}: {len(chosen)}").save(path)
                    sheets.append(path)
        page = folder / "index.html"
        page.write_text(_page(shapes, pictures), encoding="utf-8")
    except OSError as error:
        raise InfrastructureError(f"{folder} cannot be written: {error.strerror}") from error
    return PreviewFiles(tuple(sheets), page)


@contextmanager
def _renderer() -> Iterator[int]:
    client = pybullet.connect(pybullet.DIRECT)
    try:
        yield client
    finally:
        pybullet.disconnect(physicsClientId=client)


def _picture(client: int, shape: Shape) -> Picture:
    """Render a shape in its likeliest pose, turned a little; uint8 (TILE, TILE, 3)."""
    pybullet.resetSimulation(physicsClientId=client)
    pose = shape.poses[0]
    turned = product(yaw(0.5), pose.quaternion)
    body = pybullet.loadURDF(str(shape.urdf), [0, 0, 0], turned, physicsClientId=client)
    colour = HELD_OUT_COLOUR if shape.split == "held-out" else TRAIN_COLOUR
    pybullet.changeVisualShape(body, -1, rgbaColor=colour, physicsClientId=client)
    view = pybullet.computeViewMatrixFromYawPitchRoll(
        [0.0, 0.0, 0.0], CAMERA_DISTANCE, 30.0, -32.0, 0.0, 2
    )
    side = 2 * TILE
    pixels = pybullet.getCameraImage(
        side,
        side,
        view,
        pybullet.computeProjectionMatrixFOV(20.0, 1.0, 0.05, 1.0),
        lightDirection=[-0.6, -1.0, 1.4],
        shadow=0,
        lightAmbientCoeff=0.45,
        lightDiffuseCoeff=0.6,
        lightSpecularCoeff=0.05,
        renderer=pybullet.ER_TINY_RENDERER,
        physicsClientId=client,
    )
    image = np.reshape(pixels[2], (side, side, 4))[..., :3].astype(np.float64)
    mask = np.reshape(pixels[4], (side, side, 1)) >= 0
    image = np.where(mask, image, 255.0)
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
    buffer = io.BytesIO()
    Image.fromarray(picture).quantize(48).save(buffer, "PNG", optimize=True)
    data = base64.b64encode(buffer.getvalue()).decode()
    sides = " x ".join(f"{side * 1000:.0f}" for side in shape.extents)
    name = html.escape(shape.name)
    return (
        f'<figure data-family="{html.escape(shape.family)}" data-split="{shape.split}" '
        f'title="{name}"><img alt="{name}" src="data:image/png;base64,{data}"><figcaption>{name}'
        f"<br>{shape.mass * 1000:.0f} g, {shape.entry['hulls']} hulls<br>{sides} mm</figcaption>"
        "</figure>"
    )
