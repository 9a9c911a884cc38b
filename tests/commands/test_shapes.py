import pytest
import trimesh

from tests.altered import edit_document
from tests.commands.command import run, succeed
from tests.shapegen.conftest import subset
from tests.shapegen.test_object_files import obj_of


def test_what_a_stranger_named_cannot_write_to_the_terminal(tmp_path):
    (tmp_path / "red\x1b[31m\udcff\u202e.stl").touch()
    done = run("shapes", "import", tmp_path, "--output", "set", directory=tmp_path)
    assert done.code == 1
    assert done.out.startswith("red[31m.stl: no faces")
    assert "set in" not in done.out
    small = subset(tmp_path / "small", 1)
    edit_document(small / "manifest.json", lambda d: d["shapes"][0].update(sha256="\x1b[31m"))
    done = run("shapes", "check", small, directory=tmp_path)
    assert done.code == 1
    assert "\x1b" not in done.out
    run("shapes", "check", "gone", directory=tmp_path).refused(2, "gone")


def test_files_are_imported_each_with_its_unit_and_again_with_fresh(tmp_path):
    for name, side in (("box", 0.05), ("crate", 50.0)):
        (tmp_path / f"{name}.obj").write_text(obj_of(trimesh.creation.box((side, side, side))))
    command = ("shapes", "import", "box.obj", "--output", "set")
    succeed(*command, directory=tmp_path)
    scaled = (*command, "crate.obj", "--scale", 1, "--scale", "crate.obj=0.001")
    run(*scaled, directory=tmp_path).refused(6, "--fresh")
    done = succeed(*scaled, "--fresh", directory=tmp_path)
    assert "crate.obj: accepted, not promised: " in done.out
    assert "same solid" in done.out  # as box.obj
    succeed("shapes", "check", "set", "--quick", directory=tmp_path)


@pytest.mark.parametrize(
    ("scales", "word"),
    [(["mm"], "number"), (["a.obj=1", "a.obj=2"], "twice"), (["b.obj=1"], "b.obj")],
)
def test_a_wrong_scale_is_named(tmp_path, scales, word):
    (tmp_path / "a.obj").touch()
    options = [word for scale in scales for word in ("--scale", scale)]
    done = run("shapes", "import", "a.obj", "--output", "set", *options, directory=tmp_path)
    done.refused(2, word)


def test_a_set_is_not_called_like_objects_of_the_benchmark(tmp_path):
    (tmp_path / "a.obj").touch()
    for name in ("train", "cube"):
        for command in (("import", "a.obj"), ("generate",)):
            done = run("shapes", *command, "--output", name, directory=tmp_path)
            done.refused(2, "--objects")
