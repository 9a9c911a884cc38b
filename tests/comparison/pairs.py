"""Runs with outcomes as wanted, without a simulator."""

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from minitouch_bench.episode import Episode, Outcome
from minitouch_bench.files import ACTIONS_FILE
from minitouch_bench.runs.plan import Plan
from minitouch_bench.runs.run import Run
from tests.reporting.synthetic import make_run, save

TEMPLATE = save(make_run("a-policy", tasks=("pushing",), episodes=1, exploration=False))
LIMIT = 200


@dataclass(frozen=True)
class Values:
    """What the episodes of a task come to, (N,) each."""

    success: NDArray[np.bool_]
    steps: NDArray[np.int64]
    touch: NDArray[np.int64]
    touch_steps: NDArray[np.int64]


def values(success: Sequence[bool], steps=None, touch=None) -> Values:
    """Half of the control steps have contact."""
    won = np.asarray(success, bool)
    lengths = np.where(won, 20, LIMIT) if steps is None else np.asarray(steps)
    ticks = np.full(len(won), 300) if touch is None else np.asarray(touch)
    return Values(won, lengths, ticks, lengths // 2)


def draw(
    rng: np.random.Generator, skill: float, hardness: NDArray[np.float64], noise: float = 0.5
) -> Values:
    """Draw a policy's episodes: the same hardness, float (N,) in [0, 1], makes them paired.

    The policy succeeds with a chance of ``skill`` over all episodes. ``noise`` is how much of
    that is the policy's own luck: at 0 two policies of one skill succeed in the same episodes.
    """
    own = np.where(rng.random(len(hardness)) < noise, rng.random(len(hardness)), hardness)
    won = own < skill
    steps = np.where(won, np.clip(rng.gamma(5, 6, len(won)), 5, LIMIT), LIMIT).astype(int)
    touch = (steps * rng.gamma(4, 2, len(won))).astype(int)
    touch_steps = (steps * rng.beta(4, 4, len(won))).astype(int)
    return Values(won, steps, touch, touch_steps)


def make_saved(tasks: Mapping[str, Values], name: str = "a-run", digest: str | None = None) -> Run:
    episodes = tuple(
        episode(task, index, own) for task, own in tasks.items() for index in range(len(own.steps))
    )
    plan = Plan("table4", tuple(tasks), len(episodes) // len(tasks), 0)
    policy = replace(TEMPLATE.header.policy, name=name)
    header = replace(TEMPLATE.header, plan=plan, policy=policy)
    estimates = TEMPLATE.summary.tasks[0]
    summary = replace(
        TEMPLATE.summary, tasks=tuple(replace(estimates, task=task) for task in tasks)
    )
    found = {"header": header, "summary": summary, "rows": episodes}
    return replace(TEMPLATE, name=name, digest=digest or name, **found)


def episode(task: str, index: int, own: Values) -> Episode:
    won = bool(own.success[index])
    return replace(
        TEMPLATE.rows[0],
        task=task,
        index=index,
        seed=1000 + index,
        shape="",
        outcome=Outcome.SUCCESS if won else Outcome.STEP_LIMIT,
        steps=int(own.steps[index]),
        touch_interaction=int(own.touch[index]),
        touch_steps=int(own.touch_steps[index]),
    )


def shown(show, what) -> str:
    """What a function prints on a screen of 120 columns."""
    console = Console(width=120, record=True, file=io.StringIO())
    show(what, console)
    return console.export_text()


def outside_code(page: str) -> str:
    """The page without its code spans, in which GitHub shows everything as it is."""
    return re.sub(r"(`+)(?!`).*?(?<!`)\1(?!`)", "", page)


def flags(successes: int, n: int) -> NDArray[np.bool_]:
    return np.arange(n) < successes


def with_header(run: Run, **changes) -> Run:
    """Return a run with other fields of its header, or of the plan in it."""
    plan = {name: changes.pop(name) for name in [*changes] if hasattr(run.plan, name)}
    header = replace(run.header, plan=replace(run.plan, **plan), **changes)
    return replace(run, header=header)


def with_actions(run: Run, directory: Path) -> Run:
    """Return a run that is kept in a directory with a file of actions, so that it is replayable."""
    (directory / ACTIONS_FILE).touch()
    return replace(run, directory=directory)
