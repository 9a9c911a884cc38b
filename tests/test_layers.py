"""Imports go leftwards only, in the order that the project's layout gives."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import minitouch_bench

PACKAGE = Path(minitouch_bench.__file__).parent
BASE = {
    "conditions",
    "records",
    "errors",
    "optional",
    "files",
    "machine",
    "cache",
    "processes",
    "documents",
}
LAYERS = (
    "protocol",
    "metrics",
    "simulation",
    "shapegen",
    "tasks",
    "policies",
    "runs",
    "agents",
    "evaluation",
    "reporting",
    "regression",
    "verification",
    "leaderboard",
    "workflows",
    "api",
    "cli",
    "commands",
    "application",
)
SHARED = {"__init__", "options", "playing", "results", "training"}
"""What the Python interface needs of workflows/; the other modules there are a command each."""

TERMINAL = {"__init__", "command", "console", "progress"}
"""What commands need of cli/; the other modules there are the application and its groups."""

REPORT_LAYERS = {"protocol", "metrics", "runs", "reporting", "regression"}
"""They read files of a run, and draw without a simulator or torch.

Runs also need the shapes and the limits of policies, which load neither.
"""

SIMULATOR_FILES = {"simulation/client.py", "simulation/bullet.py"}


def modules():
    return {path.relative_to(PACKAGE).as_posix(): path for path in sorted(PACKAGE.rglob("*.py"))}


def imported_names(path):
    """Return every imported module, at the top or inside functions, in full."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import"
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def layer_of(relative):
    package, _, module = relative.removesuffix(".py").partition("/")
    if package == "workflows" and module not in SHARED:
        return "commands"
    if package == "cli" and module not in TERMINAL:
        return "application"
    return package


def inner_layers(path):
    """Return the layers of ours that a module imports."""
    own = {name.split(".", 1)[1] for name in imported_names(path) if is_ours(name)}
    files = {f"{name.replace('.', '/')}{end}" for name in own for end in (".py", "/__init__.py")}
    return {layer_of(file) for file in files & set(MODULES)}


def is_ours(name):
    return name.startswith("minitouch_bench.")


MODULES = modules()


def test_every_module_is_in_a_known_layer():
    known = BASE | set(LAYERS) | {"__init__"}
    assert {layer_of(relative) for relative in MODULES} <= known


@pytest.mark.parametrize("relative", MODULES)
def test_imports_go_leftwards_only(relative):
    layer, imported = layer_of(relative), inner_layers(MODULES[relative])
    if layer in BASE:
        allowed = BASE
    elif layer == "__init__":
        allowed = BASE | {"protocol", "api"}
    elif layer in REPORT_LAYERS - {"runs"}:
        allowed = BASE | {one for one in REPORT_LAYERS if LAYERS.index(one) <= LAYERS.index(layer)}
    else:
        allowed = BASE | set(LAYERS[: LAYERS.index(layer) + 1])
    assert imported <= allowed, f"{relative} imports {sorted(imported - allowed)}"


def test_the_base_imports_nothing_but_the_base_of_ours():
    for name in BASE:
        assert inner_layers(PACKAGE / f"{name}.py") <= BASE


def test_the_protocol_names_no_agent():
    for relative, path in MODULES.items():
        if layer_of(relative) == "protocol":
            assert "agents" not in inner_layers(path), relative


def test_only_the_simulation_knows_pybullet():
    for relative, path in MODULES.items():
        names = imported_names(path)
        if "pybullet" in {name.split(".")[0] for name in names}:
            assert relative in SIMULATOR_FILES, relative
        if any(name.endswith("simulation.bullet.pybullet") for name in names):
            assert relative in SIMULATOR_FILES, relative


@pytest.mark.parametrize("relative", MODULES)
def test_files_are_short(relative):
    limit = 420  # 80 to 400 is the rule
    assert len(MODULES[relative].read_text(encoding="utf-8").splitlines()) <= limit


def loaded_by(module):
    """Return the top packages that a fresh interpreter holds after one import."""
    code = f"import sys, {module}; print(*{{name.split('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize(
    "module",
    [
        "minitouch_bench",
        "minitouch_bench.records",
        "minitouch_bench.reporting",
        "minitouch_bench.regression",
    ],
)
def test_reports_are_drawn_without_torch_or_the_simulator(module):
    assert not loaded_by(module) & {"torch", "pybullet", "stable_baselines3", "onnx"}


def test_the_shape_set_is_read_without_the_means_to_make_it():
    assert not loaded_by("minitouch_bench.shapegen.manifest") & {"coacd", "manifold3d", "pybullet"}


def test_a_worker_has_the_simulator_and_no_torch():
    loaded = loaded_by("minitouch_bench.evaluation.local_engine")
    assert "pybullet" in loaded
    assert not loaded & {"torch", "stable_baselines3", "onnx", "matplotlib"}


def test_the_command_line_loads_what_a_command_needs_when_it_runs():
    heavy = {"torch", "pybullet", "matplotlib", "pandas", "scipy", "trimesh", "coacd", "jinja2"}
    heavy |= {"markdown_it", "pygments"}
    assert not loaded_by("minitouch_bench.cli.app") & heavy
