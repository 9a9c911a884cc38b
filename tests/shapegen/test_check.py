import pytest

from minitouch_bench.shapegen.check import check_set, preview
from minitouch_bench.shapegen.manifest import canonical_shape_set, load_shape_set
from tests.altered import edit_document
from tests.shapegen.conftest import subset


def test_soundness_is_proven_again(tmp_path):
    tiny_set = subset(tmp_path / "tiny", 2)
    wrong = {"misfit": 0.5, "volume_m3": 1.2e-4, "density": 9e3, "lifted": 0.5, "faces": 401}

    def negate(document):
        for pose in (pose for shape in document["shapes"] for pose in shape["poses"]):
            pose["quaternion"] = [-number for number in pose["quaternion"]]  # the same rotation

    def falsify(document):
        first, second = document["shapes"]
        first["poses"][1]["quaternion"] = [1.0, 0.0, 0.0, 0.0]
        second["poses"][1]["probability"] += 0.1
        second.update(wrong)

    edit_document(tiny_set / "manifest.json", negate)
    assert check_set(load_shape_set(tiny_set)) == ()
    edit_document(tiny_set / "manifest.json", falsify)
    problems = {tuple(text.split()[:2]) for text in check_set(load_shape_set(tiny_set))}
    names = {("shape-0001:", key) for key in (*wrong, "poses")}
    assert problems == names | {("shape-0000:", "poses")}


def test_a_flipped_byte_is_found_and_named(small_set):
    shape = load_shape_set(small_set).shapes[5]
    pack = bytearray(shape.pack.read_bytes())
    pack[shape.offset + shape.length // 2] ^= 1
    shape.pack.write_bytes(pack)
    whole, record = check_set(load_shape_set(small_set), quick=True)
    assert record.startswith("shape-0005: ")
    assert "are not the manifest's" in record
    assert whole == "the pack's SHA-256 is not the manifest's"


def test_a_swapped_split_and_a_false_mass_are_found_and_named(small_set):
    shapes = load_shape_set(small_set)
    train = shapes.shapes.index(shapes.split("train")[0])
    held = shapes.shapes.index(shapes.split("held-out")[0])

    def swap(document):
        document["shapes"][train]["split"] = "held-out"
        document["shapes"][held]["split"] = "train"
        document["shapes"][0]["mass_kg"] = 9.0

    edit_document(small_set / "manifest.json", swap)
    mass = shapes.shapes[0].mass
    assert {*check_set(load_shape_set(small_set), quick=True)} == {
        f"shape-0000: mass_kg is 9.0 in the manifest, {mass} in the record",
        f"{shapes.shapes[train].name} is marked held-out, the rule says train",
        f"{shapes.shapes[held].name} is marked train, the rule says held-out",
    }


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_canonical_set_holds():
    assert check_set(canonical_shape_set(), workers=2) == ()


def test_the_preview_shows_every_shape_with_the_sides_of_its_file(small_set, tmp_path):
    sides = {"sides_m": [0.06, 0.02, 0.061]}  # only an imported one has them
    edit_document(small_set / "manifest.json", lambda d: d["shapes"][0].update(sides))
    page = preview(load_shape_set(small_set), tmp_path / "pictures").read_text()
    assert page.count("<figure") == page.count("data:image/png;base64,iVBOR") == 16
    assert page.count("60 x 20 x 61 mm") == 1
    assert "http" not in page
