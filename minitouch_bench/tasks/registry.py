"""The one table of tasks, and what their objects can be named by."""

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import CUBE
from minitouch_bench.shapegen.manifest import ShapeSet, canonical_shape_set
from minitouch_bench.tasks.objects import (
    ObjectModel,
    ObjectPool,
    Objects,
    choose_shapes,
    shape_model,
)
from minitouch_bench.tasks.opening import Opening
from minitouch_bench.tasks.pick_up import PickUp
from minitouch_bench.tasks.playing import Playing
from minitouch_bench.tasks.pushing import Pushing
from minitouch_bench.tasks.task import Task

TASK_CLASSES: dict[str, type[Task]] = {
    task.spec.name: task for task in (Playing, Pushing, Opening, PickUp)
}
"""Every task by its name on the command line."""


def make_task(name: str) -> Task:
    """Return a new instance of a task.

    Raises:
        UsageError: no such task.
    """
    return TASK_CLASSES[PROTOCOL.task(name).name]()


def object_pool(task: Task, objects: Objects | None) -> ObjectPool | None:
    """Return the objects that a task draws from, None where it has none to choose.

    Raises:
        UsageError: no such objects.
    """
    cube = task.own_object()
    chosen = task.spec.default_objects if objects is None else objects
    if cube is None:
        if chosen:
            raise UsageError(f"{task.spec.name} has no object to choose")
        return None
    listed = () if chosen == CUBE else choose_shapes(chosen)
    known = {shape.name: shape for shape in listed}
    others = chosen if isinstance(chosen, ShapeSet) else None

    def load(name: str) -> ObjectModel:
        if name == CUBE:
            return cube
        shape = known.get(name) or (others or canonical_shape_set()).by_name(name)
        return shape_model(shape)

    return ObjectPool(tuple(known) or (CUBE,), load)
