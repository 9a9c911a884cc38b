import math
import re
from dataclasses import replace
from itertools import pairwise
from xml.etree import ElementTree

import pytest

from benchmarks.start_errors import read_scenes
from minitouch_bench.episode import Outcome
from minitouch_bench.metrics.starts import StartTest
from minitouch_bench.reporting.charts import Blocks, Spots, draw_plot
from minitouch_bench.reporting.maps import (
    MOST_SPOTS,
    MappedTask,
    change_figure,
    place_of,
    sentence,
    start_figure,
)

SCENES = read_scenes()
PUSHING = SCENES["pushing"]
MIXED = [
    replace(row, outcome=Outcome.SUCCESS if row.index % 3 else Outcome.STEP_LIMIT)
    for row in PUSHING
]


def drawn(*trainings, task="pushing"):
    figure = start_figure([MappedTask(task, "a task", trainings, f"0 {task}")])
    return figure, figure.plots[0]


def marks(plot, kind):
    return [mark for mark in plot.charts[0].marks if isinstance(mark, kind)]


def area(blocks):
    return sum((box[0] - box[2]) * (box[3] - box[1]) for box in blocks.boxes)


def test_each_episode_is_a_dot_of_its_ending_that_leads_to_it():
    figure, plot = drawn(MIXED)
    by_tone = {spots.tone: spots for spots in marks(plot, Spots)}
    assert {tone: len(spots.points) for tone, spots in by_tone.items()} == {
        "success": 66,
        "failed": 34,
    }
    assert set(by_tone["failed"].episodes) == {*range(0, 100, 3)}
    assert [item.text for item in figure.legend] == ["succeeded", "touched, but failed"]


def test_a_map_is_to_scale_with_the_robot_below():
    drawing = ElementTree.fromstring(draw_plot(drawn(MIXED)[1]))
    places = {}
    for path in drawing.iterfind("path[@data-episodes]"):
        indices = map(int, path.get("data-episodes").split())
        found = re.findall(r"M(\S+) (\S+?)h0", path.get("d"))
        places |= {i: tuple(map(float, at)) for i, at in zip(indices, found, strict=True)}
    unit = None
    for one, other in pairwise(PUSHING):
        left, away = (b - a for a, b in zip(place_of(one), place_of(other), strict=True))
        x, y = (b - a for a, b in zip(places[one.index], places[other.index], strict=True))
        unit = unit or math.hypot(x, y) / math.hypot(left, away)
        assert (x, y) == pytest.approx((-unit * left, -unit * away), abs=0.3)


def test_several_trainings_divide_the_square_of_each_scene():
    won = [replace(row, outcome=Outcome.SUCCESS) for row in MIXED]
    _, plot = drawn(MIXED, won)
    blocks = {mark.tone: mark for mark in marks(plot, Blocks)}
    assert not marks(plot, Spots)
    assert (len(blocks["success"].boxes), len(blocks["failed"].boxes)) == (100, 34)
    assert area(blocks["success"]) / area(blocks["failed"]) == pytest.approx(166 / 34)


@pytest.mark.parametrize("task", ["pushing", "opening"])
def test_thousands_of_episodes_are_counted_in_cells(task):
    many = [replace(SCENES[task][i % 100], seed=i, index=i) for i in range(MOST_SPOTS + 1)]
    _, plot = drawn(many, task=task)
    assert not marks(plot, Spots)
    (blocks,) = marks(plot, Blocks)
    assert len(blocks.boxes) <= 400
    assert len(draw_plot(plot)) < 20_000


SENTENCES = [
    (StartTest(1, 1, 1), "All of 1 episode succeeded."),
    (StartTest(30, 30, 0), "None of 30 episodes succeeded."),
    (StartTest(5, 5, 2), "5 episodes are too few to test."),
    (
        StartTest(200, 100, 100),
        "100 of 200 episodes succeeded; no part of the starts can be tested",
    ),
    (StartTest(800, 100, 300, 20, 0.3), "No dependence on the start found in 800 episodes of 100"),
    (StartTest(9, 9, 5, 4, 0.02, "it is far", (1, 5), (4, 4)), "less likely where it is far: 1 of"),
]


@pytest.mark.parametrize(("test", "words"), SENTENCES)
def test_what_is_said_below_a_map(test, words):
    assert words in sentence(test)


def test_playing_shows_the_touch_share_and_no_sentence(hac):
    rows = [row for row in hac.rows if row.task == "playing"]
    figure, plot = drawn(rows, task="playing")
    assert not plot.note
    assert figure.legend
    assert all("touch share" in item.text or "never" in item.text for item in figure.legend)


def test_a_change_is_gained_lost_or_equal():
    turned = [replace(row, outcome=Outcome.SUCCESS) for row in MIXED[:50]] + [
        replace(row, outcome=Outcome.STEP_LIMIT) for row in MIXED[50:]
    ]
    pairs = list(zip(MIXED, turned, strict=True))
    figure = change_figure("key", {"pushing": pairs}, ("A", "B"))
    assert figure.plots[0].note == "B against A: gained 17, lost 33, equal 50 episodes."
    assert {s.tone: len(s.points) for s in marks(figure.plots[0], Spots)} == {
        "success": 17,
        "fault": 33,
        "limit": 50,
    }
