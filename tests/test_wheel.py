"""What a stranger installs: one wheel, built from the sdist, in an empty environment."""

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.altered import ROOT
from tests.commands.command import same_results
from tests.process_tree import run_python

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

HELD = (
    "shapes/minitouch-1000/manifest.json",
    "shapes/minitouch-1000/shapes.bin",
    "minitouch_bench/reporting/pictures/pushing.png",
    "minitouch_bench/verification/golden.json",
)
"""Paths in the sdist; the wheel has the shapes inside the package."""

NOT_INSTALLED = ("matplotlib", "pytest", "ray", "onnx", "mypy", "tensorboardX")


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Wheel and sdist: those in the folder that MINITOUCH_DIST names, or built now."""
    if given := os.environ.get("MINITOUCH_DIST"):
        folder = Path(given).absolute()
    else:
        folder = tmp_path_factory.mktemp("dist")
        run_python("-m", "build", "--outdir", folder, ROOT)
    (wheel,), (sdist,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    return wheel, sdist


@pytest.fixture(scope="module", params=["pip", "uv"])
def installed(request, built, tmp_path_factory):
    """The folder of an environment into which nothing but the wheel was installed."""
    folder = tmp_path_factory.mktemp(request.param) / "venv"
    wheel, constraints = str(built[0]), ["--constraint", str(ROOT / "constraints.txt")]
    if request.param == "uv":
        uv = shutil.which("uv")
        if uv is None:
            pytest.skip("uv is not installed")
        subprocess.run([uv, "venv", "--quiet", "--python", sys.executable, folder], check=True)
        install = [uv, "pip", "install", "--quiet", "--python", str(folder / "bin" / "python")]
    else:
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        install = [str(folder / "bin" / "python"), "-m", "pip", "install", "--quiet"]
    subprocess.run([*install, *constraints, wheel], check=True)
    return folder


@pytest.fixture(scope="module")
def command(installed, tmp_path_factory):
    """A function that runs the installed command, with nothing of this clone and of this user."""
    place, folder = tmp_path_factory.mktemp("stranger"), tmp_path_factory.mktemp("user")
    environment = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
    for variable, name in {"HOME": "home", "TMPDIR": "tmp", "MINITOUCH_CACHE": "cache"}.items():
        (folder / name).mkdir()
        environment[variable] = str(folder / name)

    def run(*arguments):
        words = [installed / "bin" / "minitouch-bench", *arguments]
        done = subprocess.run(
            words, cwd=place, env=environment, capture_output=True, text=True, check=False
        )
        return done, place

    return run


def test_sdist_and_wheel_hold_shapes_and_pictures(built):
    wheel, sdist = built
    with zipfile.ZipFile(wheel) as archive:
        in_wheel = set(archive.namelist())
    with tarfile.open(sdist) as archive:
        in_sdist = {name.partition("/")[2] for name in archive.getnames()}
    for name in HELD:
        assert name in in_sdist
        inside = name if name.startswith("minitouch_bench/") else f"minitouch_bench/{name}"
        assert inside in in_wheel
    tops = {name.partition("/")[0] for name in in_wheel}
    assert all(name.startswith("minitouch_bench") for name in tops), tops
    assert not any(name.startswith("tests") for name in in_sdist)


def test_what_is_installed_is_what_evaluation_needs_and_the_doctor_finds_no_fault(
    installed, command
):
    code = f"import importlib.util as u; print([n for n in {NOT_INSTALLED} if u.find_spec(n)])"
    python = installed / "bin" / "python"
    assert subprocess.check_output([python, "-c", code], text=True) == "[]\n"
    done, _ = command("doctor")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("policy", ["scripted", "random"])
def test_the_smoke_suite_has_the_digests_of_the_clone(command, policy, tmp_path):
    smoke = ("evaluate", policy, "--suite", "smoke", "--workers", "auto", "--fresh")
    done, place = command(*smoke, "--output", policy)
    assert done.returncode == 0, done.stderr
    run_python("-m", "minitouch_bench", *smoke, "--output", policy, cwd=tmp_path)
    same_results(place / policy, tmp_path / policy)
    assert "data:image/png" in (place / policy / "report.html").read_text()
