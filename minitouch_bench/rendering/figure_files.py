"""Figures as SVG and PDF files for print: the drawings of the pages, on white, with their legend.

matplotlib only puts a drawing on a page of PDF, with its font inside, as publishers ask.
"""

import math
import re
import warnings
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from minitouch_bench.files import write_file
from minitouch_bench.optional import require
from minitouch_bench.rendering.charts import Figure, LegendItem
from minitouch_bench.rendering.palette import COLORS
from minitouch_bench.rendering.svg import FONT_SIZE, WIDTH, draw_mark, draw_plot, text_width

POINT = 72 / 110
"""Points of a drawing unit: text of 7 points, three plots on the width of a page."""

MARGIN, CAPTION, LEGEND = 12.0, 20.0, 18.0
"""Drawing units around each plot, for its caption, and for a row of the legend."""

FONT = "DejaVu Sans"
STYLE: dict[Any, Any] = {
    "pdf.fonttype": 42,
    "font.family": "sans-serif",
    "font.sans-serif": [FONT],
    "text.parse_math": False,
}
STROKES = {"line": 1.6, "rule": 0.5, "axis": 0.8, "hollow": 1.4}
ANCHORS = {"end": "right", "middle": "center"}
"""How SVG and matplotlib call the point of a text that is placed."""


def write_figures(figures: Sequence[Figure], directory: Path) -> list[Path]:
    """Write each figure as ``KEY.svg`` and ``KEY.pdf``; equal figures give equal bytes.

    Raises:
        MissingExtraError: matplotlib is not installed.
        RunDirectoryError: a file cannot be written.
    """
    require("matplotlib", "figures")
    paths = []
    for figure in figures:
        page = _compose(figure)
        for element in page.iter():
            _ink(element)
        paths += [directory / f"{figure.key}.{form}" for form in ("svg", "pdf")]
        write_file(paths[-2], ElementTree.tostring(page, "unicode") + "\n")
        write_file(paths[-1], _draw_pdf(page))
    return paths


def _compose(figure: Figure) -> Element:
    """Place the plots in rows of two or three, below the legend."""
    columns = min(len(figure.plots), 2 if len(figure.plots) == 4 else 3)
    drawings = [ElementTree.fromstring(draw_plot(plot)) for plot in figure.plots]
    row_height = max(_size(drawing)[1] for drawing in drawings) + CAPTION + MARGIN
    width = columns * (WIDTH + MARGIN) + MARGIN
    legend, top = _draw_legend(figure.legend, width)
    height = top + math.ceil(len(drawings) / columns) * row_height + MARGIN
    page = Element(
        "svg",
        {
            "xmlns": "http://www.w3.org/2000/svg",
            "viewBox": f"0 0 {width:g} {height:g}",
            "width": f"{width * POINT:.1f}pt",
            "height": f"{height * POINT:.1f}pt",
            "font-family": f"{FONT}, sans-serif",
            "font-size": f"{FONT_SIZE:g}",
        },
    )
    SubElement(page, "rect", {"width": "100%", "height": "100%", "fill": "#ffffff"})
    page.append(legend)
    for index, (plot, drawing) in enumerate(zip(figure.plots, drawings, strict=True)):
        left, down = MARGIN + index % columns * (WIDTH + MARGIN), index // columns * row_height
        drawing.tag = "g"
        drawing.attrib = {"transform": f"translate({left:g} {top + down + CAPTION + MARGIN:g})"}
        caption = {"class": "ink", "font-weight": "bold", "x": "0", "y": "-8"}
        SubElement(drawing, "text", caption).text = plot.caption
        page.append(drawing)
    return page


def _size(drawing: Element) -> tuple[float, float]:
    width, height = map(float, drawing.attrib["viewBox"].split()[2:])
    return width, height


def _draw_legend(items: Sequence[LegendItem], width: float) -> tuple[Element, float]:
    """Return the legend in rows that fit the width, and where it ends."""
    group = Element("g", {"transform": f"translate({MARGIN:g} 0)"})
    x, row = 0.0, 1
    for item in items:
        room = text_width(item.text) + 34
        if x and x + room > width - MARGIN:
            x, row = 0.0, row + 1
        group.append(ElementTree.fromstring(draw_mark(item, x + 5, row * LEGEND - 4, 9)))
        at = {"class": "ink", "x": f"{x + 16:g}", "y": f"{row * LEGEND:g}"}
        SubElement(group, "text", at).text = item.text
        x += room
    return group, row * LEGEND if items else 0.0


def _ink(element: Element) -> None:
    """Put attributes in the place of the classes that a page's style knows."""
    kinds = element.attrib.pop("class", "").split()
    color = next((COLORS[kind][0] for kind in kinds if kind in COLORS), COLORS["muted"][0])
    stroke = next((kind for kind in kinds if kind in STROKES), "")
    if stroke:
        width = element.attrib.get("stroke-width", f"{STROKES[stroke]:g}")
        element.attrib |= {"fill": "none", "stroke": color, "stroke-width": width}
        element.attrib |= {"stroke-linejoin": "round", "stroke-linecap": "round"}
    elif element.tag in ("path", "circle", "text"):
        element.set("fill", color)
    if anchor := next((kind for kind in kinds if kind in ANCHORS), ""):
        element.set("text-anchor", anchor)


def _draw_pdf(page: Element) -> bytes:
    """Return what an SVG file shows as a page of PDF."""
    # matplotlib takes half a second to load, and only files need it.
    import matplotlib as mpl  # noqa: PLC0415
    from matplotlib.figure import Figure as Canvas  # noqa: PLC0415
    from matplotlib.transforms import Affine2D  # noqa: PLC0415

    width, height = _size(page)
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        # A name may hold any character, also those that the font lacks.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        canvas = Canvas(figsize=(width * POINT / 72, height * POINT / 72))
        for group in page.iter("g"):
            if "transform" not in group.attrib:  # it only groups a mark and its title
                continue
            left, top = _numbers(group.attrib["transform"])
            unit = Affine2D().translate(left, top).scale(1 / width, -1 / height).translate(0, 1)
            for element in group.iter():
                _put(canvas, element, unit + canvas.transFigure)
        metadata = {"Creator": "minitouch-bench", "CreationDate": None}
        canvas.savefig(content := BytesIO(), format="pdf", metadata=metadata)
    return content.getvalue()


def _put(canvas: Any, element: Element, transform: Any) -> None:
    from matplotlib.patches import Circle, PathPatch  # noqa: PLC0415
    from matplotlib.path import Path as Outline  # noqa: PLC0415

    at = element.attrib
    if element.tag == "text":
        canvas.text(
            float(at["x"]), float(at["y"]), element.text or "", transform=transform,
            color=at["fill"], fontsize=FONT_SIZE * POINT,
            fontweight=at.get("font-weight", "normal"),
            ha=ANCHORS.get(at.get("text-anchor", ""), "left"), va="baseline",
            rotation=90 if "transform" in at else 0, rotation_mode="anchor",
        )  # fmt: skip
    look = {
        "facecolor": at.get("fill", "none"),
        "edgecolor": at.get("stroke", "none"),
        "linewidth": float(at.get("stroke-width", 0)) * POINT,
        "alpha": float(at.get("opacity", 1)),
        "joinstyle": "round",
        "capstyle": "round",
        "transform": transform,
    }
    if element.tag == "circle":
        center = float(at["cx"]), float(at["cy"])
        canvas.add_artist(Circle(center, float(at["r"]), **look))
    elif element.tag == "path":
        numbers = _numbers(at["d"])
        points = [*zip(numbers[::2], numbers[1::2], strict=True)]
        is_area = at["d"].endswith("Z")
        canvas.add_artist(PathPatch(Outline([*points, *points[:is_area]], closed=is_area), **look))


def _numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?[\d.]+", text)]
