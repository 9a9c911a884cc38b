import os
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import trimesh

from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.shapegen import exchange
from minitouch_bench.shapegen.exchange import (
    ImportConfig,
    export,
    find_objects,
    import_objects,
    import_one,
    read_object,
)
from minitouch_bench.shapegen.manifest import load_shape_set
from minitouch_bench.shapegen.solids import Solid, to_mesh
from tests.shapegen.bodies import BLOCK


def refusal(path: Path, config: ImportConfig | None = None) -> str:
    return import_one((path, config or ImportConfig()))[0]


def block(*sides: float) -> trimesh.Trimesh:
    return trimesh.creation.box(sides or BLOCK)


@pytest.mark.parametrize("suffix", ["obj", "stl", "glb"])
def test_a_block_of_each_format_is_accepted(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"block.{suffix}"
    block().export(str(path))
    reason, entry, _ = import_one((path, ImportConfig(density=9000.0)))
    assert reason == ""
    assert entry["volume_m3"] == pytest.approx(1.6192e-4, rel=1e-3)
    assert entry["mass_kg"] == pytest.approx(1.4573, rel=1e-3)


def test_a_urdf_brings_its_mesh_and_scale(tmp_path: Path) -> None:
    block(80, 46, 44).export(str(tmp_path / "mesh.obj"))
    (tmp_path / "thing.urdf").write_text(
        '<robot name="r"><link name="l"><collision><geometry><mesh filename="mesh.obj" '
        'scale="0.001 0.001 0.001"/></geometry></collision></link></robot>'
    )
    assert find_objects(tmp_path) == [tmp_path / "thing.urdf"]
    assert refusal(tmp_path / "thing.urdf") == ""


def test_a_urdf_places_its_meshes(tmp_path: Path) -> None:
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


def test_a_mesh_with_a_hole_is_refused_with_a_way_to_repair_it(tmp_path: Path) -> None:
    hole = block()
    hole.update_faces(np.arange(len(hole.faces)) > 0)
    hole.export(str(tmp_path / "hole.stl"))
    assert "watertight" in refusal(tmp_path / "hole.stl")
    assert "repair" in refusal(tmp_path / "hole.stl")


def test_no_file_that_a_mesh_names_is_opened(tmp_path: Path) -> None:
    """A pipe as material file would keep its reader waiting for ever."""
    os.mkfifo(tmp_path / "block.mtl")
    text = trimesh.exchange.obj.export_obj(block())
    (tmp_path / "block.obj").write_text("mtllib block.mtl\nusemtl gray\n" + text)
    assert refusal(tmp_path / "block.obj") == ""
    os.mkfifo(tmp_path / "mesh.obj")
    urdf = '<robot><link><collision><geometry><mesh filename="mesh.obj"/></geometry></collision>'
    (tmp_path / "pipe.urdf").write_text(f"{urdf}</link></robot>")
    assert "cannot be read" in refusal(tmp_path / "pipe.urdf")


def test_fit_gives_a_size_the_hand_can_grip(tmp_path: Path) -> None:
    block(2.8, 1.7, 1.6).export(str(tmp_path / "big.stl"))
    assert "too long" in refusal(tmp_path / "big.stl")
    assert refusal(tmp_path / "big.stl", ImportConfig(fit=True)) == ""


def test_every_file_s_name_becomes_a_plain_name_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = ("mug.obj", "mug.stl", "mug (1).obj", "a/b.obj", "a-b.obj")
    given, folder = tmp_path / "given", tmp_path / "named"
    (given / "a").mkdir(parents=True)
    for file in files:
        block().export(str(given / file))
    once = import_one((given / files[0], ImportConfig()))  # all hold the same block
    answers = enumerate([once] * len(files))
    monkeypatch.setattr(exchange, "run_in_workers", lambda *_, **__: answers)
    result = import_objects(given, folder, ImportConfig())
    assert result.accepted == len(files)
    names = {entry["source"]: entry["name"] for entry in load_shape_set(folder).document["shapes"]}
    assert names.keys() == set(files)
    assert len(set(names.values())) == len(files)
    assert names["mug (1).obj"] == "mug_1_"
    assert {"mug", "mug-2", "a-b", "a-b-2"} <= set(names.values())


def test_bad_files_are_named_each_with_its_reason(tmp_path: Path) -> None:
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
    urdf = '<robot><link><collision><geometry><mesh filename="%s" scale="%s"/></geometry>'
    urdf += "</collision></link></robot>"
    (given / "single.urdf").write_text(urdf % ("gone.stl", "0.001"))
    (given / "loop.urdf").write_text(urdf % ("loop.urdf", "1 1 1"))  # a mesh, if of itself
    (given / "outer.urdf").write_text(urdf % ("loop.urdf", "1 1 1"))
    result = import_objects(given, folder, ImportConfig())
    assert result.accepted == 1
    assert result.refused.keys() == {
        "nan.obj", "text.obj", "empty.stl", "huge.stl", "bomb.urdf", "single.urdf", "outer.urdf",
        "film.stl", "dust.stl", "grain.stl",
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
        import_objects(given, folder, ImportConfig())


def test_too_many_faces_are_refused_before_coacd(tmp_path: Path, monkeypatch) -> None:
    solid = Solid.cube((0.05, 0.05, 0.05), True)
    for x, y in product(range(-8, 9), repeat=2):
        solid -= Solid.cube((0.001, 0.001, 0.1), True).translate((0.002 * x, 0.002 * y, 0.0))
    mesh = to_mesh(solid)
    trimesh.Trimesh(mesh.vertices, mesh.faces).export(str(tmp_path / "grid.stl"))
    monkeypatch.setattr(exchange, "weighed", None)
    assert "too many faces" in refusal(tmp_path / "grid.stl")


def test_a_refusal_names_the_limit_the_value_and_an_accepted_scale(tmp_path: Path) -> None:
    things = {
        "long": (block(0.08, 0.05, 0.2), "200.0 mm, not 10 to 125 mm"),
        "wide": (block(0.11, 0.11, 0.02), "155.6 mm wide as it lies"),
        "dice": (block(0.02, 0.02, 0.02), "9 pixels where it is farthest, not 15"),
        "lopsided": (trimesh.creation.cone(0.03, 0.1), "150.0 mm, not"),
    }
    for name, (mesh, words) in things.items():
        mesh.export(str(tmp_path / f"{name}.stl"))
        said = refusal(tmp_path / f"{name}.stl")
        assert words in said
        scale = float(said.partition("accepted with --scale ")[2].rstrip(")"))
        assert refusal(tmp_path / f"{name}.stl", ImportConfig(scale)) == ""
        assert refusal(tmp_path / f"{name}.stl", ImportConfig(fit=True)) == ""


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_a_scale_is_above_0(scale: float) -> None:
    with pytest.raises(UsageError, match="--scale is a number above 0"):
        ImportConfig(scale=scale)


def test_an_empty_folder_and_no_folder(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="contains no object"):
        find_objects(tmp_path)
    with pytest.raises(UsageError, match="is no folder"):
        find_objects(tmp_path / "nowhere")


@pytest.mark.parametrize(("form", "files"), [("urdf", 3), ("obj", 1)])
def test_an_export_can_be_imported_again(
    small_set: Path, tmp_path: Path, form: str, files: int
) -> None:
    shapes = load_shape_set(small_set)
    assert export(shapes, tmp_path / "out", form) == files * len(shapes.shapes)
    name = shapes.shapes[3].name
    ending = "-visual.obj" if form == "urdf" else f".{form}"
    mesh = trimesh.load(str(tmp_path / "out" / f"{name}{ending}"), force="mesh")
    assert mesh.volume == pytest.approx(shapes.shapes[3].volume_m3, rel=1e-4)
