from dataclasses import replace
from itertools import combinations
from math import comb

import numpy as np
import pytest

from benchmarks.start_errors import SETTINGS, read_scenes, simulate
from minitouch_bench.episode import Outcome
from minitouch_bench.metrics.starts import judge_starts, start_bins

SCENES = read_scenes()


def ended(rows, won):
    """The scenes with the outcomes wanted."""
    ends = {True: Outcome.SUCCESS, False: Outcome.STEP_LIMIT}
    return [replace(row, outcome=ends[bool(win)]) for row, win in zip(rows, won, strict=True)]


def ahead(rows):
    """Whether the cube of Pushing lies nearer to the robot than its target, by 45 degrees."""
    away = np.array([np.subtract(row.start.position[:2], row.start.target) for row in rows])
    return np.abs(np.arctan2(away[:, 1], -away[:, 0])) < np.pi / 8


def test_the_part_of_the_starts_that_fails_is_named_and_counted():
    rows = SCENES["pushing"]
    (test,) = judge_starts([("pushing", ended(rows, ~ahead(rows)))])
    assert test.where == "the object lies in front of its target"
    assert test.is_found
    assert test.inside == (0, ahead(rows).sum())
    assert test.outside == (100 - ahead(rows).sum(), 100 - ahead(rows).sum())


def test_the_p_value_is_that_of_all_permutations():
    """Fifteen cabinets, five in each third: every choice of seven successes is counted."""
    rows = sorted(SCENES["opening"], key=lambda row: row.start.position[1])[:15]
    won = np.array([1, 1, 1, 1, 1, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0])
    largest = lambda wins: max(abs(sum(wins[i : i + 5]) - 7 / 3) for i in (0, 5, 10))  # noqa: E731
    chosen = (np.isin(np.arange(15), places).astype(int) for places in combinations(range(15), 7))
    exact = sum(largest(wins) >= largest(won) - 1e-9 for wins in chosen) / comb(15, 7)
    (test,) = judge_starts([("opening", ended(rows, won))])
    assert test.bins == 3
    assert test.p_value == pytest.approx(exact, abs=0.02)
    assert 0.01 < exact < 0.2


def test_a_scene_counts_once_however_many_trainings_play_it():
    rows = ended(SCENES["pushing"], np.arange(100) % 7 > 0)
    one, eight = (judge_starts([("pushing", rows * times)])[0] for times in (1, 8))
    assert eight.p_value == one.p_value
    assert (eight.episodes, eight.scenes) == (800, 100)
    assert eight.inside == tuple(8 * count for count in one.inside)


def test_what_cannot_be_tested_is_not_one_of_the_family():
    rows = SCENES["pushing"]
    won = ~ahead(rows)
    alone = judge_starts([("pushing", ended(rows, won))])
    idle = [("opening", ended(SCENES["opening"], [True] * 100)), ("pick-up", rows[:1])]
    together = judge_starts([*idle, ("pushing", ended(rows, won)), ("pushing", [])])
    assert together[2] == alone[0]
    assert [test.is_found for test in together] == [False, False, True, False]


def test_shapes_and_yaws_are_bins_where_there_are_several():
    words = [words for words, _ in start_bins("pick-up", SCENES["pick-up"])]
    families = {row.family for row in SCENES["pick-up"]}
    assert {f"the shape is of the family {family}" for family in families} <= {*words}
    assert sum("turned" in text for text in words) == 8
    pushing = dict(start_bins("pushing", SCENES["pushing"]))
    assert not any("turned" in text for text in pushing)
    assert [members.sum() for members in pushing.values()][:4] == [25] * 4


def test_reports_without_dependence_say_nothing_and_a_clear_case_is_found():
    """benchmarks/start_errors.py has the rates of 2,000 reports."""
    said, _ = simulate(SCENES, SETTINGS["success 0.9"], 60)
    assert said <= 0.15
    _, right = simulate(SCENES, SETTINGS["0.95, and 0.5 in front of the target"], 20)
    assert right >= 0.5
