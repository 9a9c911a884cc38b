"""Maps of where episodes begin, seen from above and to scale, with how each one ended."""

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from minitouch_bench.episode import Episode, Outcome
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import over_seeds, wilson
from minitouch_bench.metrics.starts import FEWEST_SCENES, HANDLE, StartTest, judge_starts
from minitouch_bench.protocol.minitouch import GOAL_TASKS, OPENING, PROTOCOL, PUSHING
from minitouch_bench.reporting import charts
from minitouch_bench.reporting.charts import LegendItem
from minitouch_bench.reporting.endings import Ending, ending_of
from minitouch_bench.reporting.labels import task_title
from minitouch_bench.text import numbered, printable

MOST_SPOTS = 1_000
"""Dots of a map; more are counted in cells."""

MOST_STACKED = 200
"""The same in Opening, whose starts lie on a line and are stacked."""

SPOT, SMALL_SPOT = 6.0, 4.2
"""Drawing units: of up to ``FEW_SPOTS`` dots, and of more."""

FEW_SPOTS = 150
SCENE, CELL = 1.7, 2.0
"""Sides in cm: of a scene that several trainings play, and of a cell of many scenes."""

MARGIN = 3.0
"""Around the workspace, cm."""

HAND = 1.2
"""Half the side of the cross at the end effector, cm."""

LEVELS = 4
"""Shades of the touch share."""

Place = tuple[float, float]
"""On a map, cm: to the left, and away from the robot."""


@dataclass(frozen=True)
class MappedTask:
    """The episodes of a map: of one run, or of the trainings of one row, a list each.

    ``source``: see ``charts.Plot``.
    """

    task: str
    caption: str
    trainings: Sequence[Sequence[Episode]]
    source: str = ""

    @property
    def episodes(self) -> list[Episode]:
        """All of them."""
        return [episode for training in self.trainings for episode in training]


def start_figure(tasks: Sequence[MappedTask]) -> charts.Figure:
    """Draw where episodes succeed and fail, and say where success depends on the start.

    One family of tests: what the figure says is false in at most 5 % of figures without any
    dependence.
    """
    tasks = [one for one in tasks if one.episodes]
    tested = [one for one in tasks if one.task in GOAL_TASKS]
    tests = judge_starts([(one.task, one.episodes) for one in tested])
    how = _test_in_words(sum(test.bins > 0 for test in tests))
    sentences = {id(one): sentence(test) for one, test in zip(tested, tests, strict=True)}
    click = "; a click on a dot shows its episode" if any(one.source for one in tasks) else ""
    plots, levels = [], []
    for one in tasks:
        placed = [(episode, _level(episode)) for episode in one.episodes]
        levels += [level for _, level in placed]
        plots.append(draw_map(one, placed, note=sentences.get(id(one), "")))
        plots += _families(one)
    return charts.Figure(
        "starts",
        "Where it succeeds and fails",
        f"{_view_in_words([one.task for one in tasks])} A square of several colors stands for "
        f"several episodes{click}.{how}",
        tuple(plots),
        _in_order(levels),
    )


def _test_in_words(tested: int) -> str:
    """Say how the sentences below ``tested`` maps were found; "" for 0 maps."""
    if not tested:
        return ""
    return (
        " Below a map: the part of the starts whose success differs most from the rest, if one "
        "permutation test over all parts finds a difference. p is adjusted for the "
        f"{numbered(tested, 'map')} that are tested."
    )


EpisodePair = tuple[Episode, Episode]
"""An episode as two policies played it."""


def change_figure(
    key: str, pairs: Mapping[str, Sequence[EpisodePair]], titles: tuple[str, str]
) -> charts.Figure:
    """Draw by task where the second run succeeds and the first does not, and the reverse.

    Playing has no success: the touch shares are compared.
    """
    first, second = titles
    gained = LegendItem(f"{second} succeeds alone; in Playing, touches more", "success")
    lost = LegendItem(f"{first} succeeds alone; in Playing, touches more", "fault")
    equal = LegendItem("equal", "limit")
    plots = []
    for task, both in pairs.items():
        value = METRICS[ranking_metric(task)].value
        changes = [(value(other) or 0.0) - (value(one) or 0.0) for one, other in both]
        levels = [gained if change > 0 else lost if change < 0 else equal for change in changes]
        counts = Counter(levels)
        placed = [(one, level) for (one, _), level in zip(both, levels, strict=True)]
        note = f"gained {counts[gained]}, lost {counts[lost]}, equal {counts[equal]}"
        mapped = MappedTask(task, task_title(task), ())
        plots.append(draw_map(mapped, placed, f"{second} against {first}: {note} episodes."))
    text = _view_in_words(pairs)
    legend = (gained, lost, equal)
    return charts.Figure(key, f"What {second} gains and loses", text, tuple(plots), legend)


def _view_in_words(tasks: Collection[str]) -> str:
    """Say what the maps of some tasks show, and where their dots are."""
    view = "Where episodes begin, seen from above and to scale, the robot below."
    if PUSHING.name in tasks:
        goal = f"{100 * PUSHING.success_distance:g} cm"
        view += f" Pushing: the gray square is the target, the circle its goal of {goal}."
    if OPENING.name in tasks:
        view += " Opening: the gray band is the cabinet. The handles are almost on one line, and "
        view += "their dots are stacked towards the robot."
    if {*tasks} - {PUSHING.name, OPENING.name}:
        view += " A cross is the hand, a frame the workspace."
    return view


def sentence(test: StartTest) -> str:
    """Say whether success depends on the start."""
    if not test.bins:
        count = numbered(test.episodes, "episode")
        ends = {0: f"None of {count} succeeded.", test.episodes: f"All of {count} succeeded."}
        few = f"{count} are too few to test."
        if test.scenes >= 2 * FEWEST_SCENES:  # all scenes have one share, or no bin has enough
            few = f"{test.successes} of {count} succeeded; no part of the starts can be tested."
        return ends.get(test.successes, few)
    if not test.is_found:
        scenes = f" of {test.scenes} scenes" if test.scenes < test.episodes else ""
        return f"No dependence on the start found in {test.episodes} episodes{scenes}."
    (won, played), (others, rest) = test.inside, test.outside
    than = "less" if won / played < others / rest else "more"
    p_value = f"p = {test.p_value:.3f}" if test.p_value >= 0.001 else "p < 0.001"
    return (
        f"Success is {than} likely where {test.where}: {won} of {played} episodes, {others} of "
        f"{rest} elsewhere ({p_value})."
    )


def _in_order(levels: Sequence[LegendItem]) -> tuple[LegendItem, ...]:
    """Return the levels that occur, in the order of endings and shades."""
    order = [*(ending.legend for ending in Ending), *map(_of_share, range(1, LEVELS + 1))]
    found = dict.fromkeys(levels)
    return tuple(sorted(found, key=lambda item: order.index(item) if item in order else 0))


def _level(episode: Episode) -> LegendItem:
    if episode.task in GOAL_TASKS or episode.outcome is Outcome.POLICY_FAULT:
        return ending_of(episode).legend
    share = METRICS["touch_share"].value(episode) or 0.0
    return _of_share(math.ceil(share * LEVELS)) if share else Ending.NEVER_TOUCHED.legend


def _of_share(level: int) -> LegendItem:
    return LegendItem(f"touch share up to {level / LEVELS:g}", f"share-{level}")


# The map


def draw_map(
    mapped: MappedTask, placed: Sequence[tuple[Episode, LegendItem]], note: str = ""
) -> charts.Plot:
    """Draw the starts of a task, colored by level: dots, or divided squares where there are many.

    The squares are of a scene that several trainings play, or of a cell of the plane, whose area
    is the number of its episodes.
    """
    task, title = mapped.task, task_title(mapped.task)
    scenes = Counter(episode.seed for episode, _ in placed)
    if len(scenes) > MOST_SPOTS or (task == OPENING.name and len(placed) > MOST_STACKED):
        marks = _blocks([(_cell(place_of(one)), level) for one, level in placed], CELL)
    elif len(scenes) < len(placed) and task != OPENING.name:
        marks = _blocks([(place_of(one), level) for one, level in placed], SCENE)
    else:
        marks = _spots(task, placed)
    x, y = _axes(task)
    chart = charts.Chart(x, y, (*_scenery(task, placed), *marks), None)
    what = f"{title}: where {numbered(len(placed), 'episode')} begin and how they end"
    return charts.Plot(mapped.caption, what, (chart,), note, mapped.source)


def place_of(episode: Episode) -> Place:
    """Return where a map shows an episode: the object, in Opening the handle.

    In Pushing relative to its target.
    """
    start = episode.start
    x, y = start.position[:2]
    if episode.task == OPENING.name:
        y += HANDLE
    if start.target is not None:
        x, y = x - start.target[0], y - start.target[1]
    return 100 * y, 100 * x


def _cell(place: Place) -> Place:
    left, away = (CELL * (math.floor(value / CELL) + 0.5) for value in place)
    return left, away


def _blocks(placed: Sequence[tuple[Place, LegendItem]], side: float) -> Iterator[charts.Mark]:
    """Yield a square at each place, its area by its episodes, divided by level from below."""
    counts: dict[Place, Counter[LegendItem]] = {}
    for place, level in placed:
        counts.setdefault(place, Counter())[level] += 1
    order = _in_order([level for _, level in placed])
    most = max(found.total() for found in counts.values())
    boxes: dict[str, list[tuple[float, float, float, float]]] = {}
    for (x, y), found in counts.items():
        total, width = found.total(), side * math.sqrt(found.total() / most)
        bottom = y - width / 2
        for level in order:
            if found[level]:
                top = bottom + width * found[level] / total
                box = (x + width / 2, bottom, x - width / 2, top)  # left is where x is greater
                boxes.setdefault(level.tone, []).append(box)
                bottom = top
    yield from (charts.Blocks(tuple(of_tone), tone) for tone, of_tone in boxes.items())


def _spots(task: str, placed: Sequence[tuple[Episode, LegendItem]]) -> Iterator[charts.Mark]:
    """Yield the dots of each color, rare colors above frequent ones."""
    size = SPOT if len(placed) <= FEW_SPOTS else SMALL_SPOT
    places = [place_of(episode) for episode, _ in placed]
    if task == OPENING.name:
        places = _stacked(places, size)
    for tone, _ in Counter(level.tone for _, level in placed).most_common():
        chosen = [i for i, (_, level) in enumerate(placed) if level.tone == tone]
        episodes = tuple(placed[i][0].index for i in chosen)
        yield charts.Spots(tuple(places[i] for i in chosen), tone, size, episodes)


def _stacked(places: Sequence[Place], size: float) -> list[Place]:
    """Stack places at almost one distance from the robot in columns towards it."""
    width = size / 4
    heights: Counter[int] = Counter()
    stacked = []
    for left, away in places:
        column = round(left / width)
        stacked.append((column * width, away - MARGIN - width * heights[column]))
        heights[column] += 1
    return stacked


def _axes(task: str) -> tuple[charts.Axis, charts.Axis]:
    """Return the axes of a task's map, left as the robot sees it and away from it."""
    if task == PUSHING.name:
        most = 100 * PUSHING.cube_distance[1] + 1
        across = charts.even_axis("cm left of the target", most, -most, 10)
        return across, charts.even_axis("cm beyond it", -most, most, 10)
    (low, right, _), (high, left, _) = _workspace(task)
    return (
        charts.even_axis("cm left of the robot", left + MARGIN, right - MARGIN, 10),
        charts.even_axis("cm ahead of it", low - MARGIN, high + MARGIN, 10),
    )


def _workspace(task: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return two corners of a task's workspace, x, y, z in cm."""
    space = PROTOCOL.task(task).workspace
    low, high = (tuple(100 * value for value in end) for end in (space.low, space.high))
    return low, high


def _scenery(task: str, placed: Sequence[tuple[Episode, LegendItem]]) -> Iterator[charts.Mark]:
    """Yield what lies around the starts: the target and its goal, the cabinet, or the hand."""
    if task == PUSHING.name:
        half = 50 * PUSHING.cube.side
        yield charts.Band(_corners(half, -half, -half, half), "muted", 0.35)
        goal = 100 * PUSHING.success_distance
        angles = [math.tau * turn / 48 for turn in range(49)]
        circle = tuple((goal * math.cos(a), goal * math.sin(a)) for a in angles)
        yield charts.Line(circle, "muted", 0.8)
        return
    (bottom, right, _), (top, left, _) = _workspace(task)
    corners = _corners(left, bottom, right, top)
    yield charts.Line((*corners, corners[0]), "muted", 0.8)
    if task == OPENING.name:
        front = 100 * min(episode.start.position[0] for episode, _ in placed)
        sides = (left + MARGIN, front, right - MARGIN, top + MARGIN)
        yield charts.Band(_corners(*sides), "muted", 0.25)
        return
    x, y, _ = placed[0][0].start.end_effector
    across, ahead = 100 * y, 100 * x
    for turn in (HAND, -HAND):
        ends = (across - HAND, ahead - turn), (across + HAND, ahead + turn)
        yield charts.Line(ends, "muted", 2.5)


def _corners(left: float, bottom: float, right: float, top: float) -> tuple[Place, ...]:
    return (left, bottom), (left, top), (right, top), (right, bottom)


def _families(mapped: MappedTask) -> Iterator[charts.Plot]:
    """Yield success by family of shapes, where there are several."""
    names = sorted({episode.family for episode in mapped.episodes})
    if mapped.task not in GOAL_TASKS or len(names) < 2:
        return
    marks: list[charts.Mark] = []
    labels = []
    for row, name in enumerate(names):
        trainings = (
            [one.success for one in part if one.family == name] for part in mapped.trainings
        )
        shares = [wilson(sum(wins), len(wins)) for wins in trainings if wins]
        found, tone = over_seeds(shares, (0.0, 1.0)), charts.series_tone(0)
        marks.append(charts.Line(((found.low, row), (found.high, row)), tone, 2.2, 0.6))
        marks.append(charts.Spots(((found.value, row),), tone, 8))
        labels.append(f"{printable(name)} ({sum(share.count for share in shares)})")
    rows, x = charts.name_axis(labels), charts.value_axis("Success, share of episodes", 1.0)
    chart = charts.Chart(x, rows, tuple(marks), charts.ROW * len(names))
    caption = f"{mapped.caption}: by family (episodes), 95 % intervals"
    yield charts.Plot(caption, f"{mapped.caption}: success by family of shapes", (chart,))
