"""What ``make`` says while pip, which is quiet, takes minutes; with a stand-in for Python."""

import os
import shutil
import subprocess

import pytest

from tests.altered import ROOT

PYTHON = """#!/bin/sh
case "$*" in
  "-m venv "*) mkdir -p "$3/bin"; cp "$0" "$3/bin/python" ;;
  *download.pytorch.org*) exit {code} ;;
esac
"""


@pytest.mark.parametrize(("code", "is_usual"), [(0, False), (1, True)])
def test_what_is_installed_is_told_with_its_size(tmp_path, code, is_usual):
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    python = tmp_path / "python"
    python.write_text(PYTHON.format(code=code))
    python.chmod(0o755)
    # Under "make test" this make would count as a nested one, and say so.
    env = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    done = subprocess.run(
        ["make", ".venv/.dev", f"PYTHON={python}"],
        check=True, cwd=tmp_path, capture_output=True, text=True, env=env,
    )  # fmt: skip
    first, *others = done.stdout.splitlines()
    assert "PyTorch" in first
    assert " GB on the disk" in first
    assert any("CUDA" in line for line in others) == is_usual
    assert (tmp_path / ".venv" / ".dev").exists()
