import json
import subprocess
import sys
from multiprocessing import get_context
from pathlib import Path

import pytest

from minitouch_bench.errors import InfrastructureError, UsageError
from minitouch_bench.shapegen.manifest import canonical_shape_set, load_shape_set
from minitouch_bench.shapegen.record import encode


def urdf_of(place: tuple[str, int]) -> str:
    """Return the URDF path of one shape; runs in another process."""
    return str(load_shape_set(place[0]).shapes[place[1]].urdf)


def test_the_canonical_set_is_the_promised_one() -> None:
    shapes = canonical_shape_set()
    assert len(shapes.shapes) == 1000
    assert len(shapes.split("train")) == 800
    assert len(shapes.split("held-out")) == 200
    assert shapes.by_name("shape-0042").name == "shape-0042"
    assert len(shapes.digest) == 64
    assert canonical_shape_set() is shapes


def test_the_canonical_bytes_are_the_manifests() -> None:
    for shape in canonical_shape_set().shapes:
        body = shape.body()
        assert encode(body) == shape.record()
        assert 0.05 <= shape.mass <= 0.5
        assert 0.04 <= max(shape.extents) <= 0.07
        assert shape.mass == body.mass
        assert len(shape.poses) >= 2


def test_reading_a_set_needs_no_geometry_library() -> None:
    code = (
        "import sys; import minitouch_bench.shapegen.manifest as m; "
        "m.canonical_shape_set(); "
        "bad = {'coacd', 'manifold3d', 'torch', 'trimesh', 'pybullet'} & set(sys.modules); "
        "sys.exit(bool(bad))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_files_are_written_once_and_kept() -> None:
    shape = canonical_shape_set().shapes[0]
    first = shape.urdf
    written = first.stat().st_mtime_ns
    assert shape.urdf == first
    assert first.is_absolute()
    assert first.stat().st_mtime_ns == written


@pytest.mark.parametrize("ending", [".urdf", "-collision.obj", "-visual.obj"])
def test_a_damaged_cached_file_is_never_used(ending: str) -> None:
    shape = canonical_shape_set().shapes[3]
    urdf = shape.urdf
    victim = urdf.with_name(urdf.name.replace(".urdf", ending))
    good = victim.read_bytes()
    victim.write_bytes(good[:-20] + b"0" * 20)
    assert shape.urdf == urdf
    assert victim.read_bytes() == good


def test_several_processes_may_begin_at_once(small_set: Path) -> None:
    context = get_context("spawn")
    with context.Pool(2) as pool:
        paths = pool.map(urdf_of, [(str(small_set), 5)] * 6)
    assert len(set(paths)) == 1
    assert not list(Path(paths[0]).parent.glob(".new-*"))


def test_a_cache_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "file"
    blocked.touch()
    monkeypatch.setenv("MINITOUCH_CACHE", str(blocked))
    with pytest.raises(InfrastructureError, match="MINITOUCH_CACHE"):
        _ = canonical_shape_set().shapes[0].urdf


def test_what_is_no_set_is_named(tmp_path: Path, small_set: Path) -> None:
    with pytest.raises(UsageError, match="holds no shape set"):
        load_shape_set(tmp_path / "nowhere")
    (tmp_path / "manifest.json").write_text("{")
    with pytest.raises(UsageError, match="cannot be read"):
        load_shape_set(tmp_path)
    (tmp_path / "manifest.json").write_text('{"schema": "minitouch-shapes-99"}')
    with pytest.raises(UsageError, match="not of schema"):
        load_shape_set(tmp_path)
    document = json.loads((small_set / "manifest.json").read_text())
    del document["shapes"][2]["mass_kg"]
    (small_set / "manifest.json").write_text(json.dumps(document))
    with pytest.raises(UsageError, match="damaged: KeyError\\('mass_kg'\\)"):
        load_shape_set(small_set)


def test_unknown_names(small_set: Path) -> None:
    shapes = load_shape_set(small_set)
    with pytest.raises(UsageError, match="no shape 'shape-9999'"):
        shapes.by_name("shape-9999")
    with pytest.raises(UsageError, match="no split 'test'"):
        shapes.split("test")


def test_the_digest_is_of_the_content_not_of_the_spacing(small_set: Path) -> None:
    before = load_shape_set(small_set).digest
    path = small_set / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()), indent=4))
    assert load_shape_set(small_set).digest == before
    document = json.loads(path.read_text())
    document["shapes"][0]["mass_kg"] *= 1.001
    path.write_text(json.dumps(document))
    assert load_shape_set(small_set).digest != before
