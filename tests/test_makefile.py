"""What ``make`` says and which Python it takes; with stand-ins for Python and uv."""

import os
import shutil
import subprocess

import pytest

from tests.altered import ROOT

PYTHON = """#!/bin/sh
case "$*" in
  "-m venv "*) mkdir -p "$3/bin"; cp "$0" "$3/bin/python" ;;
  *download.pytorch.org*) exit {index} ;;
  "-m minitouch_bench.simulation.builds") exit {library} ;;
esac
"""
UV = """#!/bin/sh
for folder; do :; done
mkdir -p "$folder/bin"; cp python "$folder/bin/python"; echo "$*" > asked
"""
TOOLS = ("sh", "dirname", "mkdir", "cp", "touch", "cat")


@pytest.fixture
def clone(tmp_path):
    """A folder with the Makefile, a stand-in for Python, and a folder ``bin`` of few tools."""
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    write(tmp_path / "python", PYTHON.format(index=0, library=0))
    (tmp_path / "bin").mkdir()
    for tool in TOOLS:
        (tmp_path / "bin" / tool).symlink_to(shutil.which(tool))
    return tmp_path


def write(path, text):
    path.write_text(text)
    path.chmod(0o755)


def run_make(clone, *arguments, code=0, **variables):
    # Under "make test" this make would count as a nested one, and say so.
    env = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    command = [shutil.which("make"), *arguments]
    env |= variables
    done = subprocess.run(command, check=False, cwd=clone, capture_output=True, text=True, env=env)
    assert done.returncode == code, done.stdout + done.stderr
    return done


@pytest.mark.parametrize(("code", "is_usual"), [(0, False), (1, True)])
def test_what_is_installed_is_told_with_its_size(clone, code, is_usual):
    write(clone / "python", PYTHON.format(index=code, library=0))
    first, *others = run_make(clone, ".venv/.dev", f"PYTHON={clone / 'python'}").stdout.splitlines()
    assert "PyTorch" in first
    assert " GB on the disk" in first
    assert any("CUDA" in line for line in others) == is_usual
    assert (clone / ".venv" / ".dev").exists()


def test_an_unknown_build_of_the_simulator_ends_it(clone):
    write(clone / "python", PYTHON.format(index=0, library=1))
    run_make(clone, ".venv/.ready", f"PYTHON={clone / 'python'}", code=2)
    assert not (clone / ".venv" / ".ready").exists()


def test_uv_finds_or_fetches_a_python_where_there_is_none(clone):
    write(clone / "bin" / "uv", UV)
    run_make(clone, ".venv/.ready", PATH=str(clone / "bin"))
    assert "--seed --python cpython>=3.11,<3.14 .venv" in (clone / "asked").read_text()
    assert (clone / ".venv" / ".ready").exists()


def without_a_python(clone, *named):
    said = run_make(clone, ".venv/.ready", *named, code=2, PATH=str(clone / "bin")).stderr
    for tool in ("uv:", "pyenv:", "apt:"):
        assert sum(line.strip().startswith(tool) for line in said.splitlines()) == 1


def test_without_a_python_it_names_what_brings_one(clone):
    without_a_python(clone)


def test_a_python_that_is_named_is_meant_and_uv_is_not_asked(clone):
    write(clone / "bin" / "uv", UV)
    without_a_python(clone, "PYTHON=python2")
    assert not (clone / "asked").exists()
