"""The Python front door: ``import minitouch_bench as mt`` gives these names."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import gymnasium
import pandas as pd

from minitouch_bench.agents.config import make_config
from minitouch_bench.conditions import parse_conditions
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.engine import EngineOptions
from minitouch_bench.metrics.definitions import metrics_shown_in
from minitouch_bench.metrics.metric import ShownIn
from minitouch_bench.policies.isolation.options import Isolation, IsolationOptions
from minitouch_bench.policies.limits import PolicyLimits
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import Estimate, Outcome, RunHeader, SavedRun, TaskSummary
from minitouch_bench.regression.comparison import Comparison, compare_runs
from minitouch_bench.reporting.frames import episodes_frame
from minitouch_bench.reporting.run_directory import read_run
from minitouch_bench.tasks.objects import Objects
from minitouch_bench.workflows import SILENT, Callbacks
from minitouch_bench.workflows import evaluate as workflow

StrPath = str | PathLike[str]
DEFAULT_LIMITS = PolicyLimits()


@dataclass(frozen=True)
class TaskResult:
    """The figures of one task: each metric is an attribute, an estimate with its interval.

    ``result.success`` is an ``Estimate`` with ``value``, ``low``, ``high`` (95 %), ``count``
    and ``method``. ``estimates`` holds them by name, ``outcomes`` how many episodes ended how.
    """

    summary: TaskSummary

    @property
    def estimates(self) -> dict[str, Estimate]:
        """The estimates by the name of their metric."""
        return dict(self.summary.estimates)

    @property
    def outcomes(self) -> dict[Outcome, int]:
        """Number of episodes by how they ended."""
        return dict(self.summary.outcomes)

    def __getattr__(self, name: str) -> Estimate:
        estimates = self.__dict__["summary"].estimates if "summary" in self.__dict__ else {}
        if name not in estimates:
            raise AttributeError(f"no metric '{name}' here; there are {', '.join(estimates)}")
        found: Estimate = estimates[name]
        return found

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self.summary.estimates})


@dataclass(frozen=True, repr=False)
class Run:
    """A finished run. ``run["pushing"]`` holds the figures of a task.

    ``directory`` is None where the run was kept in memory only. ``saved`` is the whole record.
    """

    saved: SavedRun
    directory: Path | None = None

    @property
    def header(self) -> RunHeader:
        """What fixes the run's numbers: protocol, suite, policy, and why it is unofficial."""
        return self.saved.header

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks of the run."""
        return self.saved.header.tasks

    @property
    def faults(self) -> dict[str, str]:
        """What the policy did wrong, by episode, as in ``pushing/17``."""
        return dict(self.saved.faults)

    @property
    def episodes(self) -> pd.DataFrame:
        """One row per episode, with the columns of ``episodes.csv``, family, split and digest."""
        return episodes_frame(self.saved.episodes)

    @property
    def exploration_episodes(self) -> pd.DataFrame:
        """The episodes of the exploration policy; no rows where there was none."""
        return episodes_frame(self.saved.exploration_episodes)

    def table4(self) -> pd.DataFrame:
        """Return Table 4 in the paper's shape: metrics as rows, tasks as groups of columns.

        Each task has the columns ``value``, ``low`` and ``high`` (95 %), NaN where it has no
        such figure.
        """
        columns = {}
        for summary in self.saved.summary.tasks:
            found = [summary.estimates.get(name) for name in metrics_shown_in(ShownIn.TABLE4)]
            for part in ("value", "low", "high"):
                values = [getattr(one, part) if one else float("nan") for one in found]
                columns[summary.task, part] = values
        names = pd.Index(metrics_shown_in(ShownIn.TABLE4), name="metric")
        return pd.DataFrame(columns, names)

    def __getitem__(self, task: str) -> TaskResult:
        for summary in self.saved.summary.tasks:
            if summary.task == task:
                return TaskResult(summary)
        raise KeyError(f"the run has no task '{task}'; it has {', '.join(self.tasks)}")

    def __repr__(self) -> str:
        header = self.header
        label = "official" if header.official else "unofficial"
        return f"<Run of {header.policy.name} on {header.suite}, {label}: {', '.join(self.tasks)}>"


def make(task: str, objects: Objects | None = None, **options: Any) -> gymnasium.Env[Any, Any]:
    """Return the Gymnasium environment of a task, named as on the command line.

    ``objects``: "cube", a split of the shape set ("train", "held-out", "all"), names of shapes,
    shapes of a set, or a whole set of your own; by default the task's. The other options are
    those of ``gymnasium.make``, such as ``render_mode="rgb_array"``.

    Raises:
        UsageError: no such task or objects.
    """
    return gymnasium.make(PROTOCOL.task(task).gym_id, objects=objects, **options)


def _listed(words: str | Sequence[str]) -> tuple[str, ...]:
    """Return the words of a list, or of a text with commas, as on the command line."""
    return tuple(words.split(",") if isinstance(words, str) else words)


def evaluate(
    policy: object,
    suite: str = "table4",
    *,
    tasks: str | Sequence[str] | None = None,
    episodes: int | None = None,
    seed: int | None = None,
    episodes_from: Sequence[str] = (),
    exploration: object | None = None,
    name: str | None = None,
    without: str | Sequence[str] = (),
    perturb: str | Sequence[str] = (),
    output: StrPath | None = None,
    resume: bool = False,
    fresh: bool = False,
    video: int = 0,
    workers: int | Literal["auto"] | None = None,
    engine: str = "local",
    address: str | None = None,
    isolation: str = Isolation.SANDBOX,
    trust: bool = False,
    limits: PolicyLimits = DEFAULT_LIMITS,
    callbacks: Callbacks = SILENT,
) -> Run:
    """Run a policy through a suite; options mean what they mean on the command line.

    ``policy`` and ``exploration``: a name, a file and so on as on the command line, or an
    object: anything with ``act(observation)``, and ``reset(seed, task)`` if it wants to know of
    episodes; a Stable-Baselines3 model; a torch module on (image, touch). An object runs beside
    the simulator, and its run is unofficial. ``tasks``, ``episodes``, ``seed`` None: the
    suite's own. ``without=["forces"]`` and ``perturb=["mass=0.5:2"]``: see
    ``docs/conditions.md``. ``episodes_from``: only these, as in ["pushing/3,17"]. ``workers``
    None or "auto": one per core. Without ``output`` the run is kept in memory only, and an
    interrupted one is lost.

    Raises:
        MiniTouchError: what is wrong and what to do; see ``minitouch_bench.errors``.
    """
    if isolation not in tuple(Isolation):
        raise UsageError(f"no isolation '{isolation}'; it is one of {', '.join(Isolation)}")
    options = workflow.EvaluateOptions(
        policy=policy,
        suite=suite,
        tasks=None if tasks is None else _listed(tasks),
        episodes=episodes,
        seed=seed,
        episodes_from=tuple(episodes_from),
        exploration=exploration,
        name=name,
        conditions=parse_conditions(_listed(without), _listed(perturb)),
        engine=EngineOptions(engine, None if workers == "auto" else workers, address),
        isolation=IsolationOptions(Isolation(isolation), trust, limits),
        output=workflow.OutputOptions(
            directory=None if output is None else Path(output),
            in_memory=output is None,
            resume=resume,
            fresh=fresh,
            video=video,
        ),
    )
    done = workflow.evaluate(options, callbacks)
    return Run(done.saved, done.directory)


def train(
    task: str,
    method: str = "hac",
    *,
    seed: int = 0,
    preset: str = "default",
    settings: Mapping[str, Any] = MappingProxyType({}),
    output: StrPath | None = None,
    resume: bool = False,
    device: str = "auto",
) -> Path:
    """Train a learner and return its directory, which ``evaluate`` takes as a policy.

    ``settings`` change the preset's, nested as in a TOML file of the command line:
    ``{"task_phase": {"steps": 80_000}}``. By default the directory is that of the command line.

    Raises:
        MiniTouchError: what is wrong and what to do; see ``minitouch_bench.errors``.
    """
    # Not at the top: torch takes seconds.
    from minitouch_bench.workflows import train as training  # noqa: PLC0415

    config = make_config(task, preset, settings={**settings, "method": method, "seed": seed})
    directory = training.default_directory(config) if output is None else Path(output)
    training.train(training.TrainingRequest(config, directory, resume, device))
    return directory


def load_run(path: StrPath) -> Run:
    """Read a finished run from its directory.

    Raises:
        RunDirectoryError: it is no run, or damaged.
    """
    return Run(read_run(Path(path)), Path(path))


def compare(first: Run | StrPath, second: Run | StrPath, *others: Run | StrPath) -> Comparison:
    """Compare runs of the same episodes, each with the first; runs or their directories.

    Raises:
        UsageError: they are not of the same episodes, or of other protocols.
        RunDirectoryError: a directory holds no run.
    """
    runs = [one if isinstance(one, Run) else load_run(one) for one in (first, second, *others)]
    return compare_runs(
        [run.saved for run in runs], [str(run.directory or run.saved.name) for run in runs]
    )
