"""The recipes of docs/how-to/other-libraries.md, run with the libraries that are installed."""

import re

import pytest

import minitouch_bench as mt
from minitouch_bench.policies.native import save_native
from minitouch_bench.policies.networks import ARCHITECTURES, KeypointActor
from tests.altered import DOCS
from tests.process_tree import run_python
from tests.reporting.synthetic import make_run, write

EXAMPLES = DOCS / "examples"
RECIPES = sorted(file.stem for file in (EXAMPLES / "libraries").glob("*.py"))
NEEDS = {
    "sb3_sac": ("stable_baselines3", "'minitouch-bench[sb3]'"),
    "sb3_ppo": ("stable_baselines3", "'minitouch-bench[sb3]'"),
    "sb3_frame_stack": ("stable_baselines3", "'minitouch-bench[sb3]'"),
    "torchrl_ppo": ("torchrl", "'torchrl>=0.14'"),
    "skrl_ppo": ("skrl", "'skrl>=2'"),
    "tianshou_sac": ("tianshou", "'tianshou<1'"),
    "minari_record": ("jax", "'minari[create,hdf5]'"),
}
"""What a recipe imports, and what pip installs for it."""

EVALUATED = {
    "sb3_sac": "pushing.zip",
    "sb3_frame_stack": "pushing-stacked.zip",
    "cleanrl_style": "pushing.pt2",
}
"""The file of a policy that a recipe saves to be evaluated."""


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("recipe", RECIPES)
def test_a_recipe_runs_unchanged(recipe, tmp_path):
    if recipe in NEEDS:
        module, package = NEEDS[recipe]
        pytest.importorskip(module, reason=f"pip install {package}")
    variables = {"MINARI_DATASETS_PATH": str(tmp_path / "minari")}
    run_python(EXAMPLES / "libraries" / f"{recipe}.py", cwd=tmp_path, **variables)
    if recipe in EVALUATED:
        policy = str(tmp_path / EVALUATED[recipe])
        played = mt.evaluate(policy, tasks=["pushing"], episodes=1, output=tmp_path / "run")
        assert not played.faults


def test_the_page_shows_every_recipe():
    page = (DOCS / "how-to" / "other-libraries.md").read_text()
    shown = re.findall(r'^--8<-- "docs/examples/libraries/(\w+)\.py"$', page, re.M)
    assert sorted(shown) == RECIPES
    assert NEEDS.keys() <= set(RECIPES)
    for recipe in {*RECIPES} - {"minari_record"}:  # threads that wait for a core burn others' time
        text = (EXAMPLES / "libraries" / f"{recipe}.py").read_text()
        assert "torch.set_num_threads(1)" in text


def test_the_examples_draw_a_curve_and_keypoints(tmp_path):
    pytest.importorskip("matplotlib", reason="pip install matplotlib")
    rows = "step,episodes,success\n500,4,0.25\n1000,0,\n1500,5,0.4\n"
    (tmp_path / "progress.csv").write_text(rows)
    (tmp_path / "config.toml").write_text('task = "pushing"\n')
    for name in ("early", "late"):
        write(make_run(name, tasks=("pushing",), episodes=4), tmp_path / name)
    save_native(ARCHITECTURES[KeypointActor.architecture](4, 1.0), tmp_path / "policy.safetensors")
    for script, words in (
        ("curve", (".", "500=early", "1500=late")),
        ("keypoints", ("policy.safetensors", "pushing")),
    ):
        run_python(EXAMPLES / f"{script}.py", *words, cwd=tmp_path, MPLBACKEND="agg")
        assert (tmp_path / f"{script}.png").stat().st_size > 5000
