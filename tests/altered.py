"""What tests alter: JSON documents, actions, and a copy of the package which a Python imports."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import minitouch_bench
from minitouch_bench.files import ACTIONS_FILE
from minitouch_bench.json_io import write_json

PACKAGE = Path(minitouch_bench.__file__).parent
ROOT = Path(__file__).parents[1]


def edit_document(file: Path, change: Callable[[dict[str, Any]], object]) -> None:
    document = json.loads(file.read_text())
    change(document)
    file.write_bytes(write_json(document))


def edit_actions(run: Path, change: Callable[[dict[str, Any]], object]) -> None:
    with np.load(run / ACTIONS_FILE) as archive:
        actions = dict(archive)
    change(actions)
    np.savez_compressed(run / ACTIONS_FILE, **actions)


def copy_package(root: Path) -> Path:
    """Return a copy of the package, beside links to what else it uses."""
    package = root / "copy" / "minitouch_bench"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("benchmarks", "shapes", "tests"):
        (package.parent / name).symlink_to(ROOT / name)
    return package


def edit(file: Path, *replacements: tuple[str, str]) -> None:
    content = file.read_text()
    for before, after in replacements:
        assert content.count(before) == 1, before
        content = content.replace(before, after)
    file.write_text(content)


def python(package: Path, cwd: Path, *arguments: str) -> str:
    """Return what a Python prints that imports the copy."""
    environment = {**os.environ, "PYTHONPATH": str(package.parent)}
    command = [sys.executable, *arguments]
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
