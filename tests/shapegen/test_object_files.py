import json
import os
import struct

import numpy as np
import pytest
import trimesh

from minitouch_bench.errors import UsageError
from minitouch_bench.shapegen import object_files
from minitouch_bench.shapegen.geometry import face_normals, solid_moments
from minitouch_bench.shapegen.object_files import UnreadableError, find_objects, read_object
from tests.shapegen.bodies import BLOCK


def obj_of(mesh, first=1):
    """Write a mesh with indices from ``first``, which may be minus the number of its vertices."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + first).tolist()]
    return "\n".join(lines) + "\n"


def block(*sides, at=0.0):
    return trimesh.creation.box(sides or BLOCK).apply_translation([at, 0.0, 0.0])


def read(path, text):
    path.write_text(text)
    return read_object(path)


def refusal(path):
    with pytest.raises(UnreadableError) as caught:
        read_object(path)
    return str(caught.value)


def urdf(path, *parts):
    """Write a URDF of (mesh, scale)."""
    geometry = '<collision><geometry><mesh filename="%s" scale="%s"/></geometry></collision>'
    body = "".join(geometry % part for part in parts)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"<robot><link>{body}</link></robot>")
    return path


def test_a_negative_index_counts_back_from_its_line(tmp_path):
    sides = (0.02, 0.03, 0.03)
    one, other = block(*sides, at=-0.025), block(*sides, at=0.025)
    mesh = read(tmp_path / "two.obj", obj_of(one, -8) + obj_of(other, -8))
    assert mesh.extents == pytest.approx([0.07, 0.03, 0.03])
    assert solid_moments(mesh).volume == pytest.approx(2 * np.prod(sides))


def test_an_obj_is_read_as_programs_write_it(tmp_path):
    """Indented, with texture coordinates and comments, and with lines that go on."""
    lines = obj_of(block()).replace("f 1 ", "f 1/5/7 ").splitlines()
    lines[-1] = lines[-1].replace(" ", " \\\n", 1)
    mesh = read(tmp_path / "a.obj", "".join(f"\t{line}  # said\r\n" for line in lines[:-1]))
    assert len(mesh.faces) == 11
    mesh = read(tmp_path / "b.obj", "\n".join(lines))
    assert solid_moments(mesh).volume == pytest.approx(np.prod(BLOCK))


def test_a_polygon_with_a_bay_is_cut_without_overlap(tmp_path):
    corners = [(0, 0), (6, 0), (6, 6), (4, 6), (4, 2), (0, 2)]
    for shift in range(6):  # a fan from one of the corners is right by chance
        turned = corners[shift:] + corners[:shift]
        text = "".join(f"v {x} {y} 1\n" for x, y in turned) + "f 1 2 3 4 5 6\n"
        normals, areas = face_normals(read(tmp_path / "cap.obj", text))
        assert areas.sum() == pytest.approx(20.0)
        assert normals[areas > 0.0] == pytest.approx(np.array([[0.0, 0.0, 1.0]] * 4))


@pytest.mark.parametrize("first", [0, 2, -9])
def test_an_index_without_a_vertex_is_named(tmp_path, first):
    (tmp_path / "a.obj").write_text(obj_of(block(), first))
    assert "vertex that is not there" in refusal(tmp_path / "a.obj")


@pytest.mark.parametrize("size", [1e-17, 1e-33])
@pytest.mark.parametrize("at", [0.0, 3.0])
def test_vertices_that_nearly_are_one_are_merged(tmp_path, size, at):
    """As CAD programs write a solid face by face."""
    mesh = trimesh.creation.cylinder(0.03, 0.07, sections=24).apply_translation([0.0, at, 0.0])
    corners = mesh.triangles.reshape(-1, 3)
    signs = np.random.default_rng(0).choice([-1, 0, 1], corners.shape)
    corners = corners + signs * np.maximum(size, np.where(size > 1e-20, np.spacing(corners), 0))
    soup = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    found = read(tmp_path / "cad.obj", obj_of(soup))
    assert len(found.vertices) == len(mesh.vertices)
    assert solid_moments(found).volume == pytest.approx(mesh.volume)


@pytest.mark.parametrize("scale", ["-1 1 1", "-1 -1 -1", "-1 1 -1"])
def test_a_mirrored_part_keeps_its_outside(tmp_path, scale):
    block(*BLOCK, at=0.04).export(str(tmp_path / "half.stl"))
    path = urdf(tmp_path / "thing.urdf", ("half.stl", "1 1 1"), ("half.stl", scale))
    assert solid_moments(read_object(path)).volume == pytest.approx(2 * np.prod(BLOCK))
    assert "scale is 0" in refusal(urdf(path, ("half.stl", "0 1 1")))


def test_a_mesh_of_a_ros_package_is_found_in_a_folder_above(tmp_path):
    name = "package://hand/meshes/palm.stl"
    path = urdf(tmp_path / "hand" / "urdf" / "hand.urdf", (name, "1 1 1"))
    assert name in refusal(path)
    (tmp_path / "hand" / "meshes").mkdir()
    block().export(str(tmp_path / "hand" / "meshes" / "palm.stl"))
    assert len(read_object(path).faces) == 12
    assert [*find_objects([tmp_path])] == ["hand/urdf/hand.urdf"]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.zip", b"PK\x03\x04", "OBJ, STL or GLB"),
        ("a.stl", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
        ("a.obj", b"v 1 2\nf 1 1 1\n", "no readable"),
    ],
)
def test_what_a_urdf_names_and_is_no_mesh_is_refused_by_name(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    said = refusal(urdf(tmp_path / "thing.urdf", (name, "1 1 1")))
    assert name in said
    assert words in said


def test_the_meshes_of_a_urdf_are_bounded_together(tmp_path, monkeypatch):
    block().export(str(tmp_path / "a.stl"))
    path = urdf(tmp_path / "thing.urdf", *[("a.stl", "1 1 1")] * 3)
    assert len(read_object(path).faces) == 36
    monkeypatch.setattr(object_files, "MOST_FACES", 35)
    assert "more than 35 faces" in refusal(path)
    monkeypatch.setattr(object_files, "MOST_BYTES", 3 * os.path.getsize(tmp_path / "a.stl") - 1)
    assert "MiB" in refusal(path)


@pytest.mark.parametrize(("accessors", "count"), [(1, 800_000_000), (1000, 1_000_000)])
def test_a_glb_may_not_ask_for_more_vertices_than_a_mesh_has(tmp_path, accessors, count):
    """Those that are not in the file are zeros, by the rules of the format."""
    accessor = {"componentType": 5126, "count": count, "type": "VEC3"}
    text = json.dumps({"asset": {"version": "2.0"}, "accessors": [accessor] * accessors}).encode()
    text += b" " * (-len(text) % 4)
    head = b"glTF" + struct.pack("<3I4s", 2, 20 + len(text), len(text), b"JSON")
    (tmp_path / "a.glb").write_bytes(head + text)
    assert "more than" in refusal(tmp_path / "a.glb")


def test_files_and_folders_are_given_together(tmp_path):
    for name in ("meshes/a/cup.stl", "meshes/box.obj", "mug.glb", "letter.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = find_objects([tmp_path / "meshes", tmp_path / "mug.glb"])
    assert {*found} == {"a/cup.stl", "box.obj", "mug.glb"}
    assert found["a/cup.stl"] == tmp_path / "meshes" / "a" / "cup.stl"
    with pytest.raises(UsageError, match="two objects"):
        find_objects([tmp_path / "meshes", tmp_path / "meshes" / "box.obj"])
    with pytest.raises(UsageError, match="is not an OBJ"):
        find_objects([tmp_path / "letter.txt"])
    with pytest.raises(UsageError, match="does not exist"):
        find_objects([tmp_path / "nowhere"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match="contains no object"):
        find_objects([tmp_path / "empty"])
