import json
import os
from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.shapegen.body_codec import digest, encode
from minitouch_bench.shapegen.check import check_set
from minitouch_bench.shapegen.families import FAMILIES
from minitouch_bench.shapegen.generate import write_set
from minitouch_bench.shapegen.geometry import Mesh, rotation_matrix, widest_across
from minitouch_bench.shapegen.manifest import canonical_shape_set, load_shape_set, splits_of
from minitouch_bench.shapegen.soundness import LIMITS
from tests.altered import edit_document
from tests.shapegen.conftest import entry_of


def test_the_canonical_bytes_are_the_manifests():
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


@pytest.mark.parametrize("ending", [".urdf", "-collision.obj", "-visual.obj"])
def test_a_damaged_cached_file_is_never_used(ending):
    shape = canonical_shape_set().shapes[3]
    urdf = shape.urdf
    victim = urdf.with_name(urdf.name.replace(".urdf", ending))
    good = victim.read_bytes()
    victim.write_bytes(good[:-20] + b"0" * 20)
    assert shape.urdf == urdf
    assert victim.read_bytes() == good


def test_what_is_no_set_is_named(tmp_path, small_set):
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
    ("change", "words"),
    [
        (lambda d: d["shapes"][0].update(name="../../evil"), r"shapes\[0\]\.name"),
        (lambda d: d["shapes"][0].update(split='"><script>'), r"shapes\[0\]\.split"),
        (lambda d: d["shapes"][0].update(offset=10**20), r"shapes\[0\]\.offset"),
        (lambda d: d["shapes"][0].update(mass_kg=10**400), r"shapes\[0\]\.mass_kg"),
        (lambda d: d["shapes"][1].pop("mass_kg"), r"shapes\[1\].*mass_kg"),
        (lambda d: d["shapes"][1].update(poses=[]), r"shapes\[1\]\.poses"),
        (lambda d: d.update(shapes=[], count=0), "shapes: "),
    ],
)
def test_a_damaged_manifest_is_refused(small_set, change, words):
    edit_document(small_set / "manifest.json", change)
    with pytest.raises(UsageError, match=f"{words}.*damaged"):
        load_shape_set(small_set)


@pytest.mark.timeout(30, func_only=True)
def test_a_pipe_in_place_of_the_records_is_refused_at_once(small_set):
    (small_set / "shapes.bin").unlink()
    os.mkfifo(small_set / "shapes.bin")
    with pytest.raises(UsageError, match=r"shapes\.bin cannot be read"):
        load_shape_set(small_set).shapes[0].record()


@pytest.mark.parametrize("hulls", [(), (Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)),)])
def test_a_body_of_nothing_is_named(tmp_path, hulls):
    record = encode(replace(canonical_shape_set().shapes[0].body(), hulls=hulls))
    entry = {**entry_of(0), "sha256": digest(record)}
    write_set(tmp_path, {"name": "forged"}, [(entry, record)])
    (problem,) = check_set(load_shape_set(tmp_path), quick=True)
    assert problem.endswith("the record of shape-0000 has an empty mesh")


def test_unknown_names(small_set):
    with pytest.raises(UsageError, match="no shape 'shape-9999'"):
        load_shape_set(small_set).by_name("shape-9999")
    with pytest.raises(UsageError, match=r"no split 'test'; it has held-out, train$"):
        load_shape_set(small_set).split("test")


def test_the_digest_is_of_the_content_not_of_the_spacing(small_set):
    before = load_shape_set(small_set).digest
    path = small_set / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()), indent=4))
    assert load_shape_set(small_set).digest == before
    edit_document(path, lambda d: d["shapes"][0].update(mass_kg=1.0))
    assert load_shape_set(small_set).digest != before


@pytest.mark.parametrize("count", [1, 40, 999, 1000, 1200])
def test_a_set_of_the_canonical_seed_has_the_canonical_splits(count):
    canonical = canonical_shape_set().shapes[:count]
    digests = [*(shape.digest for shape in canonical), *map(str, range(count - len(canonical)))]
    splits = splits_of(0, [*FAMILIES] * (count // 8) + [*FAMILIES][: count % 8], digests)
    assert splits[:1000] == tuple(shape.split for shape in canonical)
