from pathlib import Path

from minitouch_bench.shapegen.check import preview
from minitouch_bench.shapegen.manifest import load_shape_set


def test_the_page_shows_every_shape(small_set: Path, tmp_path: Path) -> None:
    page = preview(load_shape_set(small_set), tmp_path / "pictures").read_text()
    assert page.count("<figure") == page.count("data:image/png;base64,iVBOR") == 16
    assert "http" not in page
