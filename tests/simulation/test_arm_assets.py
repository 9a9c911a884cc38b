import subprocess
import sys

import pytest

from minitouch_bench.cache import cache_directory, content_digest, materialise
from minitouch_bench.simulation.arm_assets import light_panda

BUILD = "from minitouch_bench.simulation.arm_assets import light_panda; print(light_panda())"


def test_the_light_arm_is_light():
    meshes = sorted(light_panda().parent.glob("*-light.obj"))
    triangles = [mesh.read_text().count("\nf ") for mesh in meshes]
    assert len(meshes) >= 9
    assert max(triangles) <= 120


def test_building_at_once_in_several_processes_gives_one_set(tmp_path, monkeypatch):
    monkeypatch.setenv("MINITOUCH_CACHE", str(tmp_path / "new"))
    builders = [
        subprocess.Popen([sys.executable, "-c", BUILD], stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    printed = {builder.communicate()[0].strip() for builder in builders}
    assert [builder.returncode for builder in builders] == [0, 0]
    (directory,) = (tmp_path / "new").iterdir()
    assert printed == {str(directory / "panda.urdf")}
    assert content_digest(sorted(directory.iterdir())) == content_digest(
        sorted(light_panda().parent.iterdir())
    )


def test_a_file_is_named_by_its_content_and_repaired(tmp_path, monkeypatch):
    monkeypatch.setenv("MINITOUCH_CACHE", str(tmp_path))
    first = materialise("thing", ".txt", b"one")
    assert materialise("thing", ".txt", b"two") != first
    first.write_bytes(b"torn away")
    assert materialise("thing", ".txt", b"one").read_bytes() == b"one"
    assert sorted(tmp_path.iterdir()) == sorted({first, materialise("thing", ".txt", b"two")})


@pytest.mark.parametrize("chosen", ["MINITOUCH_CACHE", "XDG_CACHE_HOME"])
def test_the_cache_can_be_put_elsewhere(tmp_path, monkeypatch, chosen):
    monkeypatch.delenv("MINITOUCH_CACHE", raising=False)
    monkeypatch.setenv(chosen, str(tmp_path))
    assert cache_directory().is_relative_to(tmp_path)
