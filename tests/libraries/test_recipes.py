"""The recipes of docs/libraries.md, run as they stand with the libraries that are installed."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "libraries.md"
RECIPES = dict(
    re.findall(r"^## (.+)\n(?:(?!## ).*\n)*?```python\n((?:.*\n)*?)```", PAGE.read_text(), re.M)
)
NEEDS = {
    "Stable-Baselines3 SAC": ("stable_baselines3", "'minitouch-bench[sb3]'"),
    "Stable-Baselines3 PPO": ("stable_baselines3", "'minitouch-bench[sb3]'"),
    "TorchRL": ("torchrl", "'torchrl>=0.14'"),
    "skrl": ("skrl", "'skrl>=2'"),
    "tianshou": ("tianshou", "'tianshou<1'"),
    "Minari": ("jax", "'minari[create,hdf5]'"),
}
"""What a recipe imports, and what pip installs for it."""


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("library", RECIPES)
def test_a_recipe_runs_unchanged(library, tmp_path):
    if library in NEEDS:
        module, package = NEEDS[library]
        pytest.importorskip(module, reason=f"pip install {package}")
    (tmp_path / "recipe.py").write_text(RECIPES[library], encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "recipe.py"],
        cwd=tmp_path,
        env={
            **os.environ,
            "MINARI_DATASETS_PATH": str(tmp_path / "minari"),
            "OMP_NUM_THREADS": "1",  # threads that wait for a busy core burn the time of others
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_example_draws_its_curve(tmp_path):
    pytest.importorskip("stable_baselines3", reason="pip install 'minitouch-bench[sb3]'")
    script = PAGE.parent / "examples" / "curve.py"
    assert len(script.read_text().splitlines()) < 30
    subprocess.run([sys.executable, script], cwd=tmp_path, check=True)
    assert (tmp_path / "curve.png").stat().st_size > 5000


@pytest.mark.parametrize("extra", [("onnx", "onnxscript"), ("video", "moviepy")])
def test_an_extra_brings_what_its_recipe_needs(extra):
    name, package = extra
    project = tomllib.loads((PAGE.parents[1] / "pyproject.toml").read_text())["project"]
    assert any(one.startswith(package) for one in project["optional-dependencies"][name])


def test_every_need_is_of_a_recipe():
    assert NEEDS.keys() <= RECIPES.keys()
    assert len(RECIPES) == 8
