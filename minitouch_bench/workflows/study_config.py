"""A study's file: which trainings it makes, on what their policies are evaluated, its claims."""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from minitouch_bench.agents import METHODS
from minitouch_bench.agents.config import TrainingConfig, apply_settings, make_config
from minitouch_bench.conditions import STANDARD, parse_conditions
from minitouch_bench.documents import read_toml, take_table
from minitouch_bench.errors import UsageError
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.protocol.minitouch import GOAL_TASKS, MAIN_SUITE, PROTOCOL
from minitouch_bench.records import Count, Role
from minitouch_bench.reporting.claims import Claim
from minitouch_bench.reporting.study import StudyTraining
from minitouch_bench.runs.plan import find_suite

STUDY_FILE = "study.json"
"""The settings of a study, in its directory."""

OF_THE_GRID = {
    "task": "tasks",
    "method": "methods",
    "seed": "seeds",
    "exploration.steps": "exploration_steps",
}
"""What the grid sets in each training, so that ``settings`` cannot, and by which key."""


@dataclass(frozen=True)
class TaskGrid:
    """What differs in one task of a study; None keeps the study's value."""

    methods: tuple[str, ...] | None = None
    exploration_steps: tuple[int, ...] | None = None
    task_steps: Count | None = None
    suites: tuple[str, ...] | None = None


@dataclass(frozen=True)
class StudyCondition:
    """Conditions under which final policies play once more, in ``episodes`` of the main suite.

    ``without`` and ``perturb`` are those of ``evaluate``. ``methods``: whose policies; ``tasks``:
    in which tasks; by default all.

    Raises:
        UsageError: no condition is named, or one does not exist.
    """

    without: tuple[str, ...] = ()
    perturb: tuple[str, ...] = ()
    episodes: Count = 40
    methods: tuple[str, ...] = ()
    tasks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if parse_conditions(self.without, self.perturb) == STANDARD:
            raise UsageError("a condition needs 'without' or 'perturb'")

    @property
    def name(self) -> str:
        """Its directory in a training's: without colons, which Windows cannot check out."""
        words = parse_conditions(self.without, self.perturb).as_options()
        name = "-".join(word.removeprefix("--") for word in (*words, str(self.episodes)))
        return name.replace(":", "-to-")

    def concerns(self, task: str, method: str) -> bool:
        """Return whether policies of this method play under it in this task."""
        return (not self.tasks or task in self.tasks) and (
            not self.methods or method in self.methods
        )


@dataclass(frozen=True)
class StudyConfig:
    """A study, as read from its TOML file.

    Every task is trained with every method from every seed, for every length of exploration in
    ``exploration_steps``; lengths that are not given are those of ``train``. ``suites``: what each
    final policy is evaluated on, as far as the suite has the task. ``episodes`` per task; 0 for the
    suite's own. ``preset`` and ``settings`` are those of ``train``. ``per_task`` changes the grid
    in the tasks that it names. ``claims`` about its methods are judged together, over training
    seeds. ``conditions``: the final policies are also evaluated under each.
    """

    methods: tuple[str, ...]
    tasks: tuple[str, ...]
    seeds: tuple[int, ...] = (0, 1, 2)
    exploration_steps: tuple[int, ...] = ()
    task_steps: Count | None = None
    suites: tuple[str, ...] = ("table4",)
    episodes: Count = 0
    preset: str = "default"
    settings: Mapping[str, Any] = field(default_factory=dict)
    per_task: Mapping[str, TaskGrid] = field(default_factory=dict)
    claims: tuple[Claim, ...] = ()
    conditions: tuple[StudyCondition, ...] = ()

    def in_task(self, task: str) -> "StudyConfig":
        """Return the study as it is in one task."""
        changed = vars(self.per_task.get(task, TaskGrid())).items()
        return replace(self, **{name: value for name, value in changed if value is not None})

    def trainings(self) -> tuple[StudyTraining, ...]:
        """Return the trainings in the order in which they are started: seed by seed."""
        return tuple(
            StudyTraining(task, method, seed, steps)
            for seed in self.seeds
            for task in self.tasks
            for steps in self.in_task(task).exploration_steps
            or (make_config(task, self.preset).exploration.steps,)
            for method in self.in_task(task).methods
        )

    def select(self, tasks: Sequence[str], methods: Sequence[str]) -> tuple[StudyTraining, ...]:
        """Return the trainings in these tasks with these methods; an empty list selects all.

        Raises:
            UsageError: there is none.
        """
        chosen = self.trainings()
        for what, names in (("task", tasks), ("method", methods)):
            known = dict.fromkeys(getattr(training, what) for training in self.trainings())
            if unknown := [name for name in names if name not in known]:
                raise UsageError(f"the study has no {what} '{unknown[0]}', only {', '.join(known)}")
            if names:
                chosen = tuple(job for job in chosen if getattr(job, what) in names)
        if not chosen:
            raise UsageError("the study trains none of these methods in these tasks")
        return chosen

    def config_of(self, training: StudyTraining) -> TrainingConfig:
        """Return the settings of one training.

        Raises:
            UsageError: one of them does not exist.
        """
        settings: dict[str, Any] = {
            "method": training.method,
            "seed": training.seed,
            "exploration": {"steps": training.exploration_steps},
        }
        task_steps = self.in_task(training.task).task_steps
        if task_steps is not None and training.task in GOAL_TASKS:
            settings["task_phase"] = {"steps": task_steps}
        given = make_config(training.task, self.preset, settings=self.settings)
        return apply_settings(given, settings)

    def evaluations_of(self, training: StudyTraining) -> dict[str, dict[str, Any]]:
        """Return what is evaluated of a training: options of ``evaluate``, by run directory.

        Raises:
            UsageError: there is no such suite.
        """
        suites = [find_suite(name) for name in self.in_task(training.task).suites]
        found: dict[str, dict[str, Any]] = {
            suite.name: {"suite": suite.name, "episodes": self.episodes or None}
            for suite in suites
            if training.task in suite.tasks
        }
        for one in self.conditions:
            if one.concerns(training.task, training.method):
                changes = {"without": one.without, "perturb": one.perturb}
                found[one.name] = {**changes, "episodes": one.episodes or None}
        return found


def read_study(path: Path) -> StudyConfig:
    """Read a study's TOML file, and see that every training in it can be made.

    Raises:
        UsageError: it is not readable, or names what does not exist.
    """
    study = take_table(read_toml(path), StudyConfig, str(path))
    exploration = study.settings.get("exploration")
    phase = [f"exploration.{key}" for key in exploration] if isinstance(exploration, dict) else []
    for key in (*study.settings, *phase):
        if key in OF_THE_GRID:
            raise UsageError(f"{path} sets '{key}' in its settings: use '{OF_THE_GRID[key]}'")
    for task in study.tasks:
        PROTOCOL.task(task)
    for name in ("methods", "tasks", "seeds", "exploration_steps", "suites", "claims"):
        for grid in (study, *study.per_task.values()):
            values = getattr(grid, name, None) or ()
            if len(set(values)) < len(values):
                raise UsageError(f"{path} has one of its {name} twice")
    if len({condition.name for condition in study.conditions}) < len(study.conditions):
        raise UsageError(f"{path} has one of its conditions twice")
    if unknown := {*study.per_task} - {*study.tasks}:
        raise UsageError(f"{path} changes '{min(unknown)}', which is not one of its tasks")
    for training in study.trainings():
        study.config_of(training)
        study.evaluations_of(training)
    trained = {(training.task, training.method) for training in study.trainings()}
    if name := _untrained(study.conditions, trained):
        raise UsageError(f"{path} has a condition for '{name}', and does not train it")
    for claim in study.claims:
        if fault := _fault(study, claim, trained):
            raise UsageError(f"{path} has a claim on {fault}")
    return study


def _untrained(conditions: Sequence[StudyCondition], trained: Set[tuple[str, str]]) -> str:
    """Return a task or method that a condition names in vain; "" if there is none."""
    for one in conditions:
        for name in (*one.tasks, *one.methods):
            if not any(name in pair and one.concerns(*pair) for pair in trained):
                return name
    return ""


def _fault(study: StudyConfig, claim: Claim, trained: Set[tuple[str, str]]) -> str:
    """Say why a claim can never be judged; "" if it can."""
    for task, method in sorted(claim.trained - trained):
        return f"{method} in {task}, and does not train it"
    for task in claim.tasks:
        if MAIN_SUITE not in study.in_task(task).suites:
            return f"{task}, and does not play {MAIN_SUITE}"
    if METRICS[claim.metric].role is Role.EXPLORATION:
        for method in claim.methods:
            if not METHODS[method]:
                return f"the exploration of {method}, which has none"
    return ""
