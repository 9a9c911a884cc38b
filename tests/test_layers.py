"""The house has nine floors: imports go down, and never between rooms of one floor."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import minitouch_bench
from tests.process_tree import run_python

PACKAGE = Path(minitouch_bench.__file__).parent
GROUND = {
    "episode", "errors", "files", "json_io", "machine", "perturbation", "text",
    "processes", "protocol",
}  # fmt: skip
"""Rooms that may import one another, as long as their files make no circle."""

FLOORS = (
    GROUND,
    {"simulation"},
    {"shapegen", "metrics"},
    {"tasks"},
    {"runs", "policies"},
    {"evaluation", "reporting"},
    {"verification", "comparison", "agents", "console"},
    {"leaderboard", "api"},
    {"commands"},
)
DOORS = {"__init__": {"protocol", "errors", "api"}, "__main__": {"errors", "commands"}}
"""What opens the house, and the rooms that each door leads to."""


def imported_names(path, *, at_top=False):
    """Return every imported module, at the top or also inside functions, in full."""
    found = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in tree.body if at_top else ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import"
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


MODULES = {path.relative_to(PACKAGE).as_posix(): path for path in sorted(PACKAGE.rglob("*.py"))}
BY_STRING = {"__init__.py", "machine.py"}
"""Public names are imported when they are used; packages that evaluation does not need, too."""


def test_no_module_is_imported_by_a_string():
    """Such an import could go up, and no other test here would see it."""
    found = {
        relative
        for relative, path in MODULES.items()
        if any(word in path.read_text() for word in ("import_module(", "__import__("))
    }
    assert found == BY_STRING


def room_of(relative):
    return relative.split("/")[0].removesuffix(".py")


def imported_files(path, **options):
    """Return the files of ours that a module imports."""
    own = {
        name.split(".", 1)[1].replace(".", "/")
        for name in imported_names(path, **options)
        if name.startswith("minitouch_bench.")
    }
    return {f"{name}{end}" for name in own for end in (".py", "/__init__.py")} & set(MODULES)


@pytest.mark.parametrize("relative", MODULES)
def test_imports_go_down(relative):
    room = room_of(relative)
    imported = {room_of(file) for file in imported_files(MODULES[relative])} - {room}
    if room in DOORS:
        allowed = DOORS[room]
    elif room in GROUND:
        allowed = GROUND
    else:
        floor = next(i for i, rooms in enumerate(FLOORS) if room in rooms)
        allowed = set().union(*FLOORS[:floor])
    assert imported <= allowed, f"{relative} imports {sorted(imported - allowed)}"


def test_no_file_imports_itself_through_others():
    graph = {name: imported_files(path, at_top=True) - {name} for name, path in MODULES.items()}
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the files


def test_only_the_simulation_knows_pybullet():
    for relative, path in MODULES.items():
        names = imported_names(path)
        if "pybullet" in {name.split(".")[0] for name in names}:
            assert relative == "simulation/client.py", relative


TORCH = {"torch", "stable_baselines3", "onnx"}
SIMULATOR = {"pybullet"}
DRAWING = {"pandas", "matplotlib", "jinja2"}
SHAPES = {"trimesh", "scipy", "coacd", "manifold3d"}
FOREIGN = {
    "minitouch_bench": TORCH | SIMULATOR | DRAWING | SHAPES | {"typer"},
    "minitouch_bench.episode": TORCH | SIMULATOR,
    "minitouch_bench.reporting.report": TORCH | SIMULATOR,
    "minitouch_bench.comparison.gate_report": TORCH | SIMULATOR,
    "minitouch_bench.shapegen.manifest": SIMULATOR | {"coacd", "manifold3d"},
    "minitouch_bench.evaluation.rollout": TORCH | {"matplotlib"},  # what a worker runs
    "minitouch_bench.commands.app": TORCH
    | SIMULATOR
    | DRAWING
    | SHAPES
    | {"markdown_it", "pygments"},
}
"""Packages that a module does not load, at its import or by what it imports."""


@pytest.mark.parametrize("module", FOREIGN)
def test_a_module_loads_no_package_that_it_does_not_need(module):
    code = f"import sys, {module}; print(*{{name.split('.')[0] for name in sys.modules}})"
    done = run_python("-c", code)
    assert not done.stderr
    assert not set(done.stdout.split()) & FOREIGN[module]
