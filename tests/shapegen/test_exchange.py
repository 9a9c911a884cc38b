import os
from itertools import product

import numpy as np
import pytest
import trimesh

from minitouch_bench import processes
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.files import MIB
from minitouch_bench.shapegen import exchange
from minitouch_bench.shapegen.check import check_set
from minitouch_bench.shapegen.exchange import (
    ImportConfig,
    export_shapes,
    import_objects,
    import_one,
)
from minitouch_bench.shapegen.generate import PARTIAL
from minitouch_bench.shapegen.geometry import Mesh
from minitouch_bench.shapegen.manifest import load_shape_set
from minitouch_bench.shapegen.object_files import read_object
from minitouch_bench.shapegen.solids import Solid, to_mesh
from tests.shapegen.test_object_files import block, obj_of, urdf


def refusal(path, config=None):
    return import_one((path, config or ImportConfig()))[0]


def turned_inward(mesh):
    mesh.invert()
    return mesh


def written(path, *meshes):
    trimesh.util.concatenate(meshes).export(str(path))
    return path


@pytest.mark.parametrize("suffix", ["obj", "stl", "glb"])
def test_a_block_of_each_format_is_accepted(tmp_path, suffix):
    path = tmp_path / f"block.{suffix}"
    block().export(str(path))
    reason, entry, _ = import_one((path, ImportConfig(density=9000.0)))
    assert reason == ""
    assert entry["volume_m3"] == pytest.approx(1.6192e-4, rel=1e-3)
    assert entry["mass_kg"] == pytest.approx(1.4573, rel=1e-3)


def test_a_urdf_places_its_meshes(tmp_path):
    block(8.0, 4.0, 2.0).export(str(tmp_path / "mesh.obj"))
    collision = (
        '<collision>%s<geometry><mesh filename="mesh.obj" scale="1 1 0.5"/></geometry></collision>'
    )
    origin = f'<origin xyz="10 20 30" rpy="{np.pi / 2} 0 {np.pi / 2}"/>'
    parts = collision % "" + collision % origin
    (tmp_path / "two.urdf").write_text(f"<robot><link>{parts}</link></robot>")
    vertices = read_object(tmp_path / "two.urdf").vertices
    assert np.abs(vertices[:8]).max(axis=0) == pytest.approx([4.0, 2.0, 0.5])
    assert vertices[8:].mean(axis=0) == pytest.approx([10.0, 20.0, 30.0])
    # The roll turns y into z, then the yaw x into y and z's -y into x.
    assert np.ptp(vertices[8:], axis=0) == pytest.approx([1.0, 8.0, 4.0])


def test_no_file_that_a_mesh_names_is_opened(tmp_path):
    """A pipe as material file would keep its reader waiting for ever."""
    os.mkfifo(tmp_path / "block.mtl")
    text = trimesh.exchange.obj.export_obj(block())
    (tmp_path / "block.obj").write_text("mtllib block.mtl\nusemtl gray\n" + text)
    assert refusal(tmp_path / "block.obj") == ""
    os.mkfifo(tmp_path / "mesh.obj")
    path = urdf(tmp_path / "pipe.urdf", ("mesh.obj", "1 1 1"))
    assert "cannot be read" in refusal(path)


def test_every_file_s_name_becomes_a_plain_name_of_its_own(tmp_path, monkeypatch):
    files = ("mug.obj", "mug.stl", "mug (1).obj", "a/b.obj", "a-b.obj")
    given, folder = tmp_path / "given", tmp_path / "named"
    (given / "a").mkdir(parents=True)
    for file in files:
        block().export(str(given / file))
    reason, entry, record = import_one((given / files[0], ImportConfig()))  # all are this block
    answers = [(reason, {**entry, "not_promised": []}, record) for _ in files]
    monkeypatch.setattr(exchange, "run_in_workers", lambda *_, **__: enumerate(answers))
    result = import_objects([given], folder, ImportConfig())
    assert ["same solid" in str(texts) for texts in result.not_promised.values()].count(True) == 4
    assert check_set(load_shape_set(folder), quick=True) == ()
    names = {entry["source"]: entry["name"] for entry in load_shape_set(folder).document["shapes"]}
    assert names.keys() == set(files)
    assert {*names.values()} == {"mug", "mug-2", "mug_1_", "a-b", "a-b-2"}


def test_bad_files_are_named_each_with_its_reason(tmp_path):
    given, folder = tmp_path / "given", tmp_path / "out"
    given.mkdir()
    block().export(str(given / "good.stl"))
    (given / "nan.obj").write_text("v 0 0 0\nv nan 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\n")
    (given / "text.obj").write_text("Dear reader,\nthis is a letter.\n")
    (given / "empty.stl").touch()
    block(0.06, 0.06, 1e-6).export(str(given / "film.stl"))
    for name, side in (("dust", 1e-12), ("grain", 1e-5)):
        block(side, side, side).export(str(given / f"{name}.stl"))
    with (given / "huge.stl").open("wb") as file:
        file.truncate(500_000_084)  # ten million faces
    (given / "bomb.urdf").write_text('<!DOCTYPE a [<!ENTITY b "c">]><robot>&b;</robot>')
    urdf(given / "single.urdf", ("gone.stl", "0.001"))
    urdf(given / "loop.urdf", ("loop.urdf", "1 1 1"))
    urdf(given / "outer.urdf", ("loop.urdf", "1 1 1"))
    result = import_objects([given], folder, ImportConfig())
    assert result.accepted == 1
    assert result.refused.keys() == {
        "nan.obj", "text.obj", "empty.stl", "huge.stl", "bomb.urdf", "single.urdf", "outer.urdf",
        "loop.urdf", "film.stl", "dust.stl", "grain.stl",
    }  # fmt: skip
    assert "not a finite number" in result.refused["nan.obj"]
    assert "too thin" in result.refused["film.stl"]
    assert "too long or too short" in result.refused["grain.stl"]
    assert "larger than" in result.refused["huge.stl"]
    assert all("\n" not in reason for reason in result.refused.values())
    shapes = load_shape_set(folder)
    assert shapes.shapes[0].name == "good"
    assert shapes.document["refused"] == result.refused
    with pytest.raises(RunDirectoryError, match="already"):
        import_objects([given], folder, ImportConfig())


def test_too_many_faces_are_refused_before_coacd(tmp_path, monkeypatch):
    solid = Solid.cube((0.05, 0.05, 0.05), True)
    for x, y in product(range(-8, 9), repeat=2):
        solid -= Solid.cube((0.001, 0.001, 0.1), True).translate((0.002 * x, 0.002 * y, 0.0))
    (tmp_path / "grid.obj").write_text(obj_of(to_mesh(solid)))
    monkeypatch.setattr(exchange, "weighed", None)
    assert "too many faces" in refusal(tmp_path / "grid.obj")


def test_a_refusal_names_the_limit_the_value_and_an_accepted_scale(tmp_path):
    things = {
        "long": (block(0.08, 0.05, 0.2), "200.0 mm, not 10 to 125 mm"),
        "wide": (block(0.11, 0.11, 0.02), "155.6 mm wide as it lies"),
        "dice": (block(0.02, 0.02, 0.02), "9 pixels where it is farthest, not 15"),
        "lopsided": (trimesh.creation.cone(0.03, 0.1), "150.0 mm, not"),
    }
    for name, (mesh, words) in things.items():
        path = written(tmp_path / f"{name}.stl", mesh)
        said = refusal(path)
        assert words in said
        scale = float(said.partition("accepted with --scale ")[2])
        assert refusal(path, ImportConfig(scale)) == ""
        assert refusal(path, ImportConfig(fit=True)) == ""


def test_a_usual_unit_is_named_first_and_no_scale_where_none_was_accepted(tmp_path):
    """A rod that is long enough to be seen is too long for the hand's place."""
    assert "accepted with --scale 0.0254" in refusal(written(tmp_path / "a.stl", block(3, 2, 2)))
    rod = trimesh.creation.cylinder(2.0, 150.0, sections=12)
    said = refusal(written(tmp_path / "rod.stl", rod))
    assert "accepted with" not in said
    assert "no accepted scale" in said


def test_a_cavity_is_named_whatever_way_the_faces_are_turned(tmp_path):
    outer, inner = block(0.06, 0.05, 0.05), turned_inward(block(0.04, 0.03, 0.03))
    assert "hollow" in refusal(written(tmp_path / "box.stl", outer, inner))
    both = [turned_inward(outer), turned_inward(inner)]
    assert "hollow" in refusal(written(tmp_path / "inside_out.stl", *both))
    sides = np.roll([0.004, 0.06, 0.06], 1), np.roll([0.004, 0.06, 0.06], 2), (0.004, 0.06, 0.06)
    walls = [
        block(*side).apply_translation(sign * 0.028 * (np.array(side) < 0.005))
        for side in sides
        for sign in (-1.0, 1.0)
    ]
    assert "hollow" in refusal(written(tmp_path / "walls.stl", *walls))


def test_a_part_turned_inward_that_is_inside_no_other_is_a_part(tmp_path):
    left = block(0.04, 0.05, 0.06, at=-0.019)
    right = turned_inward(block(0.04, 0.05, 0.06, at=0.019))
    reason, entry, _ = import_one((written(tmp_path / "pair.stl", left, right), ImportConfig()))
    assert reason == ""
    assert entry["volume_m3"] == pytest.approx(0.078 * 0.05 * 0.06, rel=0.01)
    apart = written(tmp_path / "apart.stl", left, right.apply_translation((0.01, 0.0, 0.0)))
    assert "more than one body" in refusal(apart)


def test_what_is_no_solid_is_refused_with_the_reason(tmp_path):
    """All but the hole once ended the import of all, or had a size of a billion meters."""
    hole = block()
    hole.update_faces(np.arange(len(hole.faces)) > 0)
    crossing = block(0.06, 0.05, 0.04)
    crossing.vertices[[0, 7]] = crossing.vertices[[7, 0]]
    needle = block(0.06, 0.05, 0.04)
    needle.vertices *= [1.0, 1e-6, 1e-6]
    huge = Mesh(np.array(block().vertices) * 1e160, np.array(block().faces))
    path = tmp_path / "mesh.obj"
    for mesh, words in (
        (hole, "watertight mesh; repair it"),
        (crossing, "cross"),
        (needle, "no volume"),
        (huge, "no solid"),
    ):
        path.write_text(obj_of(mesh))
        with np.errstate(all="ignore"):
            assert words in refusal(path)
            assert words in refusal(path, ImportConfig(fit=True))


def test_a_worker_that_dies_or_runs_out_of_memory_stops_no_other_object(tmp_path, monkeypatch):
    given = tmp_path / "given"
    given.mkdir()
    for name in ("dies", "good"):
        block().export(str(given / f"{name}.stl"))
    trimesh.creation.icosphere(6, 0.03).export(str(given / "large.stl"))
    real = exchange.import_in_worker

    def import_or_die(task):
        if task[0].stem == "dies":
            os.abort()
        if task[0].stem == "large":
            exchange._limit_memory.cache_clear()
            exchange.MOST_MEMORY = MIB
        return real(task)

    monkeypatch.setattr(processes, "MAX_ATTEMPTS", 1)
    monkeypatch.setattr(exchange, "import_in_worker", import_or_die)
    result = import_objects([given], tmp_path / "set", ImportConfig())
    assert [*result.not_promised] == ["good.stl"]
    assert "exit code" in result.refused["dies.stl"]
    assert "memory" in result.refused["large.stl"]


def test_a_set_tells_the_sides_and_the_unit_of_each_file(tmp_path):
    upright = block(8, 20, 60).apply_translation((-26, 0, 26))
    path = written(tmp_path / "bracket.stl", block(60, 20, 8), upright)
    config = ImportConfig(scales={"bracket.stl": 0.001})
    assert import_objects([path], tmp_path / "set", config).refused == {}
    shapes = load_shape_set(tmp_path / "set")
    assert shapes.by_name("bracket").sides_m == pytest.approx((0.06, 0.02, 0.06))
    assert shapes.document["imported"]["scales"] == config.scales


def test_only_an_imported_set_is_replaced(tmp_path, small_set):
    path = written(tmp_path / "one.stl", block())
    begun = tmp_path / "begun"
    begun.mkdir()
    (begun / PARTIAL).write_text("shapes that ``generate`` has made so far")
    with pytest.raises(RunDirectoryError, match=PARTIAL):
        import_objects([path], begun, ImportConfig(), fresh=True)
    with pytest.raises(RunDirectoryError, match="not imported"):
        import_objects([path], small_set, ImportConfig(), fresh=True)
    assert len(load_shape_set(small_set).shapes) == 16


@pytest.mark.parametrize("scale", [0.0, float("nan"), float("inf")])
def test_a_scale_is_above_0(scale):
    with pytest.raises(UsageError, match="--scale is a number above 0"):
        ImportConfig(scale=scale)


@pytest.mark.parametrize(("form", "files"), [("urdf", 3), ("obj", 1)])
def test_an_export_can_be_imported_again(small_set, tmp_path, form, files):
    shapes = load_shape_set(small_set)
    assert export_shapes(shapes, tmp_path / "out", form) == files * len(shapes.shapes)
    name = shapes.shapes[3].name
    ending = "-visual.obj" if form == "urdf" else f".{form}"
    mesh = trimesh.load(str(tmp_path / "out" / f"{name}{ending}"), force="mesh")
    assert mesh.volume == pytest.approx(shapes.shapes[3].volume_m3, rel=1e-4)
