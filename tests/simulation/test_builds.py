from pathlib import Path

import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.simulation import builds
from tests.process_tree import run_python


def test_the_installed_library_is_known_without_being_loaded():
    code = (
        "import sys; from minitouch_bench.simulation import builds; print(builds.check_library()); "
        "assert 'pybullet' not in sys.modules"
    )
    assert "known build of pybullet" in run_python("-c", code).stdout


@pytest.mark.parametrize("name", [*builds.KNOWN_BUILDS, "pybullet.cpython-314-x86_64-linux-gnu.so"])
def test_another_library_is_refused_where_a_build_is_known(name, tmp_path, monkeypatch):
    library = tmp_path / name
    library.write_bytes(b"\x7fELF of somebody else")
    spec = type("Spec", (), {"origin": str(library)})
    monkeypatch.setattr(builds.importlib.util, "find_spec", lambda _: spec)
    if name in builds.KNOWN_BUILDS:
        with pytest.raises(UsageError, match="--force-reinstall"):
            builds.check_library()
    else:
        assert "compiled" in builds.check_library()


def test_every_pinned_distribution_has_a_known_build():
    pinned = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    owners = {owner for known in builds.KNOWN_BUILDS.values() for owner in known.values()}
    assert owners == builds.BUILDS.keys()
    for name, version in builds.BUILDS.items():
        assert f'"{name}=={version};' in pinned


@pytest.mark.parametrize(
    ("python", "build"),
    [((3, 11), "pybullet==3.2.7"), ((3, 13), "pybullet-arm64==3.2.8")],
)
def test_another_simulator_than_the_protocol_s_is_refused(monkeypatch, python, build):
    monkeypatch.setattr(builds, "installed_versions", lambda _: {"pybullet": "3.2.6"})
    monkeypatch.setattr(builds.sys, "version_info", python)
    with pytest.raises(UsageError, match=f"pip install {build}"):
        builds.check_version()
