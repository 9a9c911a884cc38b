"""The one table of tasks, and what their objects can be named by."""

from collections.abc import Sequence

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.tasks import TabletopSpec
from minitouch_bench.shapegen.manifest import ShapeSet
from minitouch_bench.tasks.objects import CUBE, ObjectPool, shape_model, shape_names
from minitouch_bench.tasks.opening import Opening
from minitouch_bench.tasks.pick_up import PickUp
from minitouch_bench.tasks.playing import Playing
from minitouch_bench.tasks.pushing import Pushing
from minitouch_bench.tasks.task import Task

Objects = str | Sequence[str] | ShapeSet
"""What an environment's objects can be named by."""

TASKS: dict[str, type[Task]] = {
    task.spec.name: task for task in (Playing, Pushing, Opening, PickUp)
}
"""Every task by its name on the command line."""


def make_task(name: str) -> Task:
    """Return a new instance of a task.

    Raises:
        UsageError: no such task.
    """
    if name not in TASKS:
        raise UsageError(f"no task '{name}'; the tasks are {', '.join(TASKS)}")
    return TASKS[name]()


def object_pool(task: Task, objects: Objects | None) -> ObjectPool | None:
    """Return the objects that a task draws from, None where it has none to choose.

    Raises:
        UsageError: no such objects.
    """
    own = task.own_object()
    chosen = task.spec.default_objects if objects is None else objects
    if own is None or not isinstance(task.spec, TabletopSpec):
        if chosen:
            raise UsageError(f"{task.spec.name} has no object to choose")
        return None
    stands = task.spec.stands
    if isinstance(chosen, ShapeSet):
        own_shapes = chosen
        return ObjectPool(
            tuple(shape.name for shape in own_shapes.shapes),
            lambda name: shape_model(name, stands, own_shapes),
        )
    names = (CUBE,) if chosen == CUBE else shape_names(chosen)
    return ObjectPool(names, lambda name: own if name == CUBE else shape_model(name, stands))
