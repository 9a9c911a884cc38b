"""The viewer of one episode: a page of what the robot saw, felt and did, and the same as CSV."""

import base64
import io
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from jinja2.utils import htmlsafe_json_dumps
from numpy.typing import NDArray
from PIL import Image

from minitouch_bench.episode import Film, Outcome
from minitouch_bench.files import write_file
from minitouch_bench.json_io import StrPath, checked
from minitouch_bench.metrics.summary import measure
from minitouch_bench.perturbation import Perturbation
from minitouch_bench.protocol.minitouch import OPENING, PICK_UP, PROTOCOL, PUSHING
from minitouch_bench.reporting.endings import Ending, ending_of
from minitouch_bench.reporting.labels import run_names, task_title
from minitouch_bench.reporting.pages import TEMPLATES, render_page
from minitouch_bench.reporting.tables import rows_csv
from minitouch_bench.runs.run import Run
from minitouch_bench.text import numbered, printable

TOUCH_COLUMNS = (
    "end_effector_x_m", "end_effector_y_m", "end_effector_z_m",
    "left_opening_mm", "right_opening_mm",
    "left_force_x_N", "left_force_y_N", "left_force_z_N",
    "right_force_x_N", "right_force_y_N", "right_force_z_N",
)  # fmt: skip
"""The touch vector, its openings in mm."""
OBJECT_COLUMNS = {1: ("door_angle_rad",), 3: ("object_x_m", "object_y_m", "object_z_m")}
"""The object's state, by how many numbers it has."""
ACTION_COLUMNS = ("action_dx", "action_dy", "action_dz", "action_fingers", "action_yaw")

AIMS = {
    "playing": "Touch the object as often as possible; there is no goal.",
    "pushing": "Push the dark object to the gray target.",
    "opening": "Find the handle and open the door.",
    "pick-up": "Grasp the object and lift it.",
}
"""What a policy is to do, for somebody who sees a task for the first time."""

STILL = {"cm": 0.5, "°": 1.0}
"""An object or a door that was never farther from its start did not move."""
SCENE_QUALITY = 90
"""Of WebP, 0 to 100."""


@dataclass(frozen=True)
class Quantity:
    """How near an episode was to its goal, T + 1 values; Playing has no goal."""

    title: str
    unit: str
    values: NDArray[np.float64]
    goal: int | None = None


def quantity_of(film: Film) -> Quantity:
    """Return how near a filmed episode was to its goal."""
    state, task = film.played.trace.object_state, film.played.spec.task
    if task == OPENING.name:
        goal = round(math.degrees(OPENING.success_angle))
        return Quantity("Angle of the door", "°", np.degrees(state[:, 0]), goal)
    if task == PICK_UP.name:
        lifted = 100 * (state[:, 2] - state[0, 2])
        return Quantity("Object above its start", "cm", lifted, round(100 * PICK_UP.lift))
    if (target := film.played.start.target) is not None:
        distance = 100 * np.hypot(*(state[:, :2] - target).T)
        return Quantity("Object to target", "cm", distance, round(100 * PUSHING.success_distance))
    return Quantity("Object from its start", "cm", _displacement(film))


def _displacement(film: Film) -> NDArray[np.float64]:
    """Return how far the object is from its start, in cm, or the door, in degrees: T + 1 values."""
    state = film.played.trace.object_state
    moved = np.linalg.norm(state - state[0], axis=1)
    return np.degrees(moved) if film.played.spec.task == OPENING.name else 100 * moved


def ending_in_words(film: Film, fault: str = "") -> str:
    """Say how an episode ended, and the likeliest reason where it failed."""
    trace, outcome = film.played.trace, film.played.outcome
    steps, touching = len(trace.actions), np.flatnonzero(trace.contact_ticks) + 1
    what = "door" if film.played.spec.task == OPENING.name else "object"
    contact = f"a finger touched the {what} in {len(touching)} of {numbered(steps, 'step')}"
    if not len(touching):
        contact = f"no finger touched the {what} in {numbered(steps, 'step')}"
    elif touching[-1] < steps * 3 / 4:
        contact += f", the last time at step {touching[-1]}"
    if fault:
        return f"The policy failed after {numbered(steps, 'step')}: {printable(fault)}"
    if outcome is Outcome.SUCCESS:
        return f"Success at step {steps}; {contact}."
    if outcome is Outcome.LEFT_WORKSPACE:
        return f"The object left the workspace at step {steps}; {contact}."
    return f"{_what_was_reached(film, what)}; {contact}."


def _what_was_reached(film: Film, what: str) -> str:
    progress, moved = quantity_of(film), _displacement(film).max()
    values, unit = progress.values, progress.unit
    if moved < STILL[unit]:
        return f"The {what} did not move"
    if progress.goal is None:
        return f"The {what} moved by up to {moved:.1f} {unit}"
    best = values.min() if values[0] > progress.goal else values.max()
    reached = f"{best:.1f} {unit} at best, the goal is {progress.goal} {unit}"
    return f"Did not reach the goal: {progress.title.lower()} {reached}"


def episode_columns(film: Film, conditions: Perturbation) -> Mapping[str, list[float | None]]:
    """Return T + 1 values per column: at the reset, and of each control step or at its end."""
    trace = film.played.trace
    seconds = np.concatenate(([0], np.cumsum(trace.ticks))) / PROTOCOL.physics.tick_rate
    names = ("time_s", *TOUCH_COLUMNS, *OBJECT_COLUMNS[trace.object_state.shape[1]])
    at_ends = np.column_stack((seconds, _in_units(trace.touch), trace.object_state))
    at_ends = at_ends.round(6) + 0.0  # no -0.0
    columns: dict[str, list[float | None]] = dict(zip(names, at_ends.T.tolist(), strict=True))
    of_steps = {"ticks": trace.ticks, "contact_ticks": trace.contact_ticks}
    of_steps |= dict(zip(ACTION_COLUMNS, trace.actions.T.astype(np.float64).round(6), strict=False))
    columns |= {name: [None, *values.tolist()] for name, values in of_steps.items()}
    return columns | _given_columns(film, conditions)


def _given_columns(film: Film, conditions: Perturbation) -> dict[str, list[float | None]]:
    """Return what the policy was given in place of what ``conditions`` change in the touch vector.

    T + 1 values per column; none at the end, since no action follows.
    """
    if not conditions.changes_forces:
        return {}
    changed = slice(None) if conditions.changes_touch else PROTOCOL.observation.forces
    given = (_in_units(film.touch).round(6) + 0.0).T.tolist()
    rest = [None] * (len(film.scenes) - len(film.touch))
    names = [f"given_{name}" for name in TOUCH_COLUMNS[changed]]
    return {name: [*values, *rest] for name, values in zip(names, given[changed], strict=True)}


def _in_units(touch: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return touch vectors (N, 11) in the units of their columns."""
    in_units = touch.astype(np.float64)
    in_units[:, PROTOCOL.observation.openings] *= 1000 * PROTOCOL.control.finger_open
    return in_units


def episode_csv(run: Run, film: Film) -> str:
    """Write an episode of a run as CSV: a row for the reset, and one per control step."""
    columns = episode_columns(film, run.plan.conditions)
    rows = zip(range(len(film.scenes)), *columns.values(), strict=True)
    return rows_csv(("step", *columns), rows)


@dataclass(frozen=True, repr=False)
class EpisodePage:
    """The page of one replayed episode: a notebook shows it, and ``save`` writes it as a file."""

    title: str
    html: str

    @checked
    def save(self, path: StrPath) -> Path:
        """Write the page, which opens offline.

        Raises:
            RunDirectoryError: the file cannot be written.
        """
        write_file(Path(path), self.html)
        return Path(path)

    def __repr__(self) -> str:
        return f"<EpisodePage of {self.title}>"

    def _repr_html_(self) -> str:
        title, content = escape(self.title), escape(self.html)
        style = "width:100%;height:900px;border:0"
        return f'<iframe title="{title}" srcdoc="{content}" style="{style}"></iframe>'


@dataclass(frozen=True)
class ReplayedEpisode:
    """An episode of a run, filmed; ``is_as_recorded``: the replay gave the recorded bits."""

    run: Run
    film: Film
    is_as_recorded: bool

    @property
    def ending(self) -> Ending:
        """How the replay ended."""
        return ending_of(measure(self.film.played))

    @property
    def words(self) -> str:
        """How it ended in one sentence, with the likeliest reason where it failed."""
        return ending_in_words(self.film, self.run.faults.get(self.film.played.spec.key, ""))

    @property
    def conditions(self) -> Perturbation:
        """The conditions, with the light of the suite."""
        return self.run.plan.conditions_in_light()

    @property
    def is_lit(self) -> bool:
        """Whether the policy saw the scene in its usual light."""
        return self.conditions.light in (None, (1.0, 1.0))

    def track(self, name: str) -> Mapping[str, Any]:
        """Return what the page's script draws."""
        progress = quantity_of(self.film)
        return {
            "name": name,
            "columns": episode_columns(self.film, self.run.plan.conditions),
            "progress": asdict(progress) | {"values": progress.values.round(3).tolist()},
            "marks": list(_marks(self.film)),
            "scenes": _sprite(self.film.scenes, quality=SCENE_QUALITY),
            "images": _sprite(self.film.images, lossless=True),
        }


def episode_page(one: ReplayedEpisode, beside: ReplayedEpisode | None = None) -> EpisodePage:
    """Compose the page of an episode, ``beside`` the same one in another run on one time axis."""
    spec = one.film.played.spec
    title = f"{task_title(spec.task)}, episode {spec.index}"
    shown = [one, beside] if beside else [one]
    names = run_names([part.run for part in shown])
    goal = PROTOCOL.task(spec.task).goal
    data = {
        "limit": PROTOCOL.task(spec.task).force_limit,
        "tracks": [part.track(name) for part, name in zip(shown, names, strict=True)],
    }
    html = render_page(
        TEMPLATES / "viewer.html.j2",
        ("viewer.css",),
        ("theme.js", "viewer.js"),
        title=title,
        shown=shown,
        names=names,
        run=one.run,
        spec=spec,
        goal=f"{AIMS[spec.task]} Success: {goal}." if goal else AIMS[spec.task],
        data=htmlsafe_json_dumps(data, separators=(",", ":"), allow_nan=False),
    )
    return EpisodePage(f"{' beside '.join(part.run.name for part in shown)}: {title}", html)


def _marks(film: Film) -> Iterator[Mapping[str, Any]]:
    """Yield what happened and when: the first touch if there was one, and the end."""
    trace, rate = film.played.trace, PROTOCOL.physics.tick_rate
    if trace.first_touch_tick >= 0:
        yield {"text": "first touch", "tone": "touched", "time": trace.first_touch_tick / rate}
    ending = ending_of(measure(film.played))
    yield {"text": ending, "tone": ending.tone, "time": int(trace.ticks.sum()) / rate}


def _sprite(pictures: NDArray[np.uint8], **options: Any) -> Mapping[str, Any]:
    """Join pictures (N, H, W) or (N, H, W, 3) into one, row by row, as a data URI."""
    count, height, width = pictures.shape[:3]
    columns = max(1, math.ceil(math.sqrt(count)))
    grid = np.zeros((columns * math.ceil(count / columns) or 1, *pictures.shape[1:]), np.uint8)
    grid[:count] = pictures
    rows = grid.reshape(-1, columns, *pictures.shape[1:]).swapaxes(1, 2)
    picture = Image.fromarray(rows.reshape(-1, columns * width, *pictures.shape[3:]))
    content = io.BytesIO()
    picture.save(content, "WEBP", method=4, **options)
    uri = "data:image/webp;base64," + base64.b64encode(content.getvalue()).decode("ascii")
    return {"uri": uri, "columns": columns, "width": width, "height": height, "count": count}
