"""The episodes of runs as every page shows them: how each ended, in a browser of its own.

``kit.html.j2`` has the browser, ``episodes.js`` fills it from ``browser_data``.
"""

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote

from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup

from minitouch_bench import files
from minitouch_bench.episode import Episode, Outcome, Role, episode_key
from minitouch_bench.errors import UnreadableFileError, printable
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL
from minitouch_bench.runs.run import Run


class Ending(StrEnum):
    """How an episode ended; each one has exactly one ending."""

    tone: str
    meaning: str

    def __new__(cls, value: str, tone: str, meaning: str) -> Self:
        """Make an ending with its color, and what it means."""
        ending = str.__new__(cls, value)
        ending._value_, ending.tone, ending.meaning = value, tone, meaning
        return ending

    # In the order of every table.
    SUCCEEDED = "succeeded", "success", "the goal was reached"
    TOUCHED = "touched", "touched", "Playing has no goal: a finger touched the object"
    TOUCHED_FAILED = (
        "touched, but failed", "failed", "a finger touched the object, the step limit came first",
    )  # fmt: skip
    LEFT = (
        "object left the workspace", "left",
        "a finger touched the object, which then left the workspace",
    )  # fmt: skip
    NEVER_TOUCHED = (
        "never touched by a finger", "limit",
        "no finger touched the object; the hand may have pushed it out of the workspace",
    )  # fmt: skip
    FAULT = "policy fault", "fault", "the policy raised, timed out or gave no valid action"


def ending_of(episode: Episode) -> Ending:
    """Return how an episode ended."""
    if episode.outcome is Outcome.POLICY_FAULT:
        return Ending.FAULT
    if episode.success:
        return Ending.SUCCEEDED
    if not episode.touch_interaction:
        return Ending.NEVER_TOUCHED
    if episode.outcome is Outcome.LEFT_WORKSPACE:
        return Ending.LEFT
    return Ending.TOUCHED_FAILED if episode.task in GOAL_TASKS else Ending.TOUCHED


@dataclass(frozen=True)
class BrowsedRun:
    """A run in the browser of a page.

    ``path``: what ``replay`` takes as the run, wherever the page is. ``address``: of the run's
    directory, relative to the page; a page that is opened from a disk shows the path it leads to.
    ``viewers``: addresses of the viewers that were made, by episode.
    """

    title: str
    run: Run
    path: str
    address: str = ""
    viewers: Mapping[str, str] = field(default_factory=dict)


def find_viewers(run: Run, replays: Path, page: Path) -> dict[str, str]:
    """Return the addresses of a run's viewers for a page in the directory ``page``, by episode."""
    if not files.is_folder(replays):
        return {}
    with files.os_errors_as(UnreadableFileError, replays, "read"):
        names = set(os.listdir(replays))
    base = relative_address(replays, page)
    keys = (episode_key(role, row.task, row.index) for role, rows in run.by_role() for row in rows)
    found = {key: files.view_name(key, ".html") for key in keys}
    return {key: f"{base}/{name}" for key, name in found.items() if name in names}


def relative_address(path: Path, page: Path) -> str:
    """Return the address of a file or directory for a page in the directory ``page``."""
    return quote(Path(os.path.relpath(path, page)).as_posix())


def browser_data(runs: Sequence[BrowsedRun], tasks: Collection[str] = ()) -> Markup:
    """Write the episodes as JSON that no reader of HTML takes for markup.

    ``tasks``: those whose episodes are shown, () for all.
    """
    document = {
        "endings": [ending.value for ending in Ending],
        "tones": [ending.tone for ending in Ending],
        "failures": list(Ending).index(Ending.TOUCHED_FAILED),
        "runs": [
            {
                "title": one.title,
                "path": one.path,
                "address": one.address,
                "viewers": one.viewers,
                "groups": list(_groups(one.run, tasks)),
            }
            for one in runs
        ],
    }
    return htmlsafe_json_dumps(document, separators=(",", ":"), allow_nan=False)


def _groups(run: Run, tasks: Collection[str]) -> Iterator[dict[str, Any]]:
    """Yield the episodes of each role and task, a list per column."""
    numbers = {ending: number for number, ending in enumerate(Ending)}
    for role, rows in run.by_role():
        for task in dict.fromkeys(row.task for row in rows if not tasks or row.task in tasks):
            episodes = [row for row in rows if row.task == task]
            shapes = [printable(row.shape) for row in episodes]
            yield {
                "key": task if role is Role.FINAL else f"exploration/{task}",
                "index": [row.index for row in episodes],
                "ending": [numbers[ending_of(row)] for row in episodes],
                "steps": [row.steps for row in episodes],
                "ticks": [row.touch_interaction for row in episodes],
                "touched": [row.touch_steps for row in episodes],
                "first": [_seconds(row) for row in episodes],
                "shapes": shapes if len(set(shapes)) > 1 else None,
            }


def _seconds(episode: Episode) -> float | None:
    """Return the time of the first touch in few digits, None where there is none."""
    tick = episode.first_touch_tick
    return None if tick is None else round(tick / PROTOCOL.physics.tick_rate, 3)
