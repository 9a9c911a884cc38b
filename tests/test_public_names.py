import ast
from collections import Counter, defaultdict
from importlib import import_module
from pathlib import Path

from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL, TASK_NAMES
from minitouch_bench.tasks.task import TASK_CLASSES
from tests.process_tree import run_python
from tests.test_layers import MODULES

GYM_IDS = {
    "playing": "MiniTouch/Playing-v1",
    "pushing": "MiniTouch/Pushing-v1",
    "opening": "MiniTouch/Opening-v1",
    "pick-up": "MiniTouch/PickUp-v1",
}


def test_the_tasks_have_one_table_and_one_order():
    assert tuple(TASK_CLASSES) == TASK_NAMES == tuple(GYM_IDS)
    assert TASK_NAMES[1:] == GOAL_TASKS
    assert {task: PROTOCOL.task(task).gym_id for task in TASK_NAMES} == GYM_IDS


def test_gymnasium_makes_each_task_with_no_import_of_ours():
    code = f"""
import gymnasium
for name in {list(GYM_IDS.values())}:
    environment = gymnasium.make("minitouch_bench:" + name, render_mode="rgb_array")
    observation, _ = environment.reset(seed=1)
    assert environment.spec.id == name
    print(observation["image"].shape, environment.action_space.shape)
    environment.close()
"""
    done = run_python("-W", "error", "-c", code)
    assert done.stdout.splitlines().count("(1, 84, 84) (4,)") == 3
    assert not done.stderr


def test_one_name_means_one_thing():
    """Only a command bears the name of what it calls, and several modules are also programs."""
    places = [place for place in MODULES if not place.startswith(("commands/", "__"))]
    stems = Counter(Path(place).stem for place in places if not place.endswith("__init__.py"))
    assert {stem for stem, number in stems.items() if number > 1} == set()
    found = defaultdict(dict)
    for place in places:
        module = import_module(f"minitouch_bench.{place[:-3].replace('/', '.')}")
        for node in ast.parse(MODULES[place].read_text(encoding="utf-8")).body:
            names = [node.name] if isinstance(node, ast.ClassDef | ast.FunctionDef) else []
            if isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names = [target.id for target in targets if isinstance(target, ast.Name)]
            for name in names:
                if not name.startswith("_") and name not in {"main", "Array", "Progress"}:
                    found[name][id(getattr(module, name))] = place
    assert {name: where for name, where in found.items() if len(where) > 1} == {}
