from pathlib import Path

from minitouch_bench.shapegen.check import preview
from minitouch_bench.shapegen.manifest import load_shape_set
from tests.altered import edit_document


def test_the_page_shows_every_shape(small_set: Path, tmp_path: Path) -> None:
    page = preview(load_shape_set(small_set), tmp_path / "pictures").read_text()
    assert page.count("<figure") == page.count("data:image/png;base64,iVBOR") == 16
    assert "http" not in page


def test_an_imported_object_has_the_sides_of_its_file(small_set: Path, tmp_path: Path) -> None:
    sides = {"sides_m": [0.06, 0.02, 0.061]}
    edit_document(small_set / "manifest.json", lambda d: d["shapes"][0].update(sides))
    page = preview(load_shape_set(small_set), tmp_path / "pictures").read_text()
    assert page.count("60 x 20 x 61 mm") == 1
