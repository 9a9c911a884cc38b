import json
from pathlib import Path

import numpy as np
import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.spec import Split
from minitouch_bench.shapegen.body_codec import encode
from minitouch_bench.shapegen.generate import family_of
from minitouch_bench.shapegen.manifest import canonical_shape_set, load_shape_set, splits_of
from minitouch_bench.shapegen.mesh import rotation_matrix, widest_across
from minitouch_bench.shapegen.soundness import LIMITS
from tests.altered import edit_document


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
        assert LIMITS.mass[0] <= shape.mass <= LIMITS.mass[1]
        assert LIMITS.longest_side[0] <= max(shape.extents) <= LIMITS.longest_side[1]
        laid = rotation_matrix(shape.poses[0].quaternion)
        placed = np.concatenate([hull.vertices for hull in body.hulls]) @ laid.T
        # Measured where statics puts it; the simulator leaves it turned by a fraction of a degree.
        assert np.ptp(placed[:, 2]) >= LIMITS.least_height - 5e-4
        assert widest_across(placed[:, :2]) + 2 * LIMITS.margin <= LIMITS.widest + 5e-4
        assert shape.mass == body.mass
        assert len(shape.poses) >= 2


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


def test_what_is_no_set_is_named(tmp_path: Path, small_set: Path) -> None:
    with pytest.raises(UsageError, match="contains no shape set"):
        load_shape_set(tmp_path / "nowhere")
    for text in ("{", "[" * 100_000):
        (tmp_path / "manifest.json").write_text(text)
        with pytest.raises(UsageError, match="cannot be read"):
            load_shape_set(tmp_path)
    (tmp_path / "manifest.json").write_text('{"schema": "minitouch-shapes-99"}')
    with pytest.raises(UsageError, match="not of schema"):
        load_shape_set(tmp_path)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("name", "../../evil"),
        ("split", '"><script>alert(1)</script>'),
        ("offset", 10**20),
        ("mass_kg", 10**400),
    ],
)
def test_a_set_that_writes_elsewhere_or_more_is_refused(
    small_set: Path, key: str, value: object
) -> None:
    edit_document(small_set / "manifest.json", lambda d: d["shapes"][0].update({key: value}))
    with pytest.raises(UsageError, match=rf"shapes\[0\]\.{key}.*damaged"):
        load_shape_set(small_set)


@pytest.mark.parametrize("key", ["mass_kg", "files_sha256", "faces"])
def test_a_shape_without_what_others_read_of_it_is_refused(small_set: Path, key: str) -> None:
    edit_document(small_set / "manifest.json", lambda d: d["shapes"][1].pop(key))
    with pytest.raises(UsageError, match=rf"shapes\[1\].*{key}.*damaged"):
        load_shape_set(small_set)


def test_a_set_without_shapes_and_a_shape_without_poses_are_refused(small_set: Path) -> None:
    edit_document(small_set / "manifest.json", lambda d: d["shapes"][1].update(poses=[]))
    with pytest.raises(UsageError, match=r"shapes\[1\]\.poses.*damaged"):
        load_shape_set(small_set)
    edit_document(small_set / "manifest.json", lambda d: d.update(shapes=[], count=0))
    with pytest.raises(UsageError, match=r"shapes: .*damaged"):
        load_shape_set(small_set)


def test_unknown_names(small_set: Path) -> None:
    shapes = load_shape_set(small_set)
    with pytest.raises(UsageError, match="no shape 'shape-9999'"):
        shapes.by_name("shape-9999")
    with pytest.raises(UsageError, match=r"no split 'test'; it has held-out, train$"):
        shapes.split("test")


def test_the_digest_is_of_the_content_not_of_the_spacing(small_set: Path) -> None:
    before = load_shape_set(small_set).digest
    path = small_set / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()), indent=4))
    assert load_shape_set(small_set).digest == before
    edit_document(path, lambda d: d["shapes"][0].update(mass_kg=1.0))
    assert load_shape_set(small_set).digest != before


def splits_of_first(count: int, seed: int) -> tuple[str, ...]:
    """Return the splits of the first shapes of a seed; their records matter in seed 0 alone."""
    canonical = canonical_shape_set().shapes
    digests = [canonical[i].digest if i < 1000 else str(i) for i in range(count)]
    return splits_of(seed, [family_of(i) for i in range(count)], digests)


def test_the_canonical_set_follows_the_rule() -> None:
    assert splits_of_first(1000, 0) == tuple(s.split for s in canonical_shape_set().shapes)


@pytest.mark.parametrize("seed", [0, 7])
def test_a_shape_keeps_its_split_whatever_the_size_of_its_set(seed: int) -> None:
    whole = splits_of_first(1200, seed)
    for count in (1, 40, 999, 1000, 1001):
        assert splits_of_first(count, seed) == whole[:count]


def test_other_seeds_hold_out_one_in_five_of_each_family_at_other_places() -> None:
    found = {seed: splits_of_first(400, seed) for seed in (1, 2)}
    assert found[1] != found[2]
    for splits in found.values():
        for family in range(8):
            assert splits[family::8].count(Split.HELD_OUT) == 10
        # The place within five is not always the same one.
        assert len({splits[start : start + 40 : 8].index(Split.HELD_OUT) for start in range(8)}) > 1


def test_an_imported_set_is_split_as_a_whole() -> None:
    splits = splits_of(None, ["imported"] * 50, [str(i) for i in range(50)])
    assert (splits.count(Split.HELD_OUT), splits.count(Split.TRAIN)) == (10, 40)
