from pathlib import Path

from PIL import Image

from minitouch_bench.shapegen.manifest import load_shape_set
from minitouch_bench.shapegen.preview import preview


def test_sheets_and_page_show_every_shape(small_set: Path, tmp_path: Path) -> None:
    shapes = load_shape_set(small_set)
    *sheets, index = preview(shapes, tmp_path / "pictures")
    page = index.read_text()
    assert page.count("<figure") == 16
    assert "http" not in page
    groups = {(shape.family, shape.split) for shape in shapes.shapes}
    assert len(sheets) == len(groups)
    with Image.open(sheets[0]) as sheet:
        low, high = sheet.convert("L").getextrema()
    assert low < 100
    assert high == 255
