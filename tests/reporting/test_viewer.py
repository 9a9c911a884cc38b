"""What the viewer says and writes of an episode; tests/verification/test_filming.py opens one."""

import csv
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.episode import EpisodeSpec, Film, Outcome, PlayedEpisode, Role, Start
from minitouch_bench.reporting.viewer import (
    ReplayedEpisode,
    ending_in_words,
    episode_csv,
    episode_page,
)
from tests.reporting.synthetic import make_trace


def make_film(task="pick-up", *, steps=4, touching=(), outcome=Outcome.STEP_LIMIT, state=None):
    """Make a film without a simulator, in which a finger touches at these steps, from 1 on."""
    rng = np.random.default_rng(0)
    contact = np.array([60 if step + 1 in touching else 0 for step in range(steps)], np.int16)
    fixed = np.tile([0.5, 0.0, 0.02], (steps + 1, 1))
    trace = replace(
        make_trace(rng, steps, task, contact=0.0),
        ticks=np.full(steps, 60, np.int16),
        contact_ticks=contact,
        object_state=fixed if state is None else np.array(state, np.float64),
        first_touch_tick=60 * (min(touching) - 1) if touching else -1,
    )
    spec = EpisodeSpec(Role.FINAL, task, 0, 7)
    scenes = rng.integers(0, 255, (steps + 1, 24, 24, 3), np.uint8)
    images = rng.integers(0, 255, (steps, 84, 84), np.uint8)
    target = (0.6, 0.0) if task == "pushing" else None
    start = Start((0.5, 0.0, 0.0), 0.0, target, (0.5, 0.1, 0.04))
    return Film(PlayedEpisode(spec, outcome, start, trace), scenes, images, trace.touch[:-1])


def places(*x):
    return [[one, 0.0, 0.0] for one in x]


@pytest.mark.parametrize(
    ("film", "words"),
    [
        (make_film(), "did not move; no finger touched the object in 4 steps"),
        (make_film(touching=(1, 4)), "did not move; a finger touched the object in 2 of 4"),
        (  # the hand pushed it along the table
            make_film("pick-up", state=places(0.5, 0.5, 0.52, 0.6, 0.62)),
            "above its start 0.0 cm at best, the goal is .*; no finger touched the object",
        ),
        (  # around the target, at one distance
            make_film(
                "pushing", touching=(2,), state=[[0.5, 0, 0], [0.6, 0.1, 0], *places(0.7) * 3]
            ),
            "object to target 10.0 cm at best",
        ),
        (
            make_film("opening", touching=(2,), state=[[0.0], [0.0], [0.2], [0.2], [0.2]]),
            "angle of the door 11.5 ° at best, the goal is 30",
        ),
        (
            make_film("playing", steps=2, state=places(0.5, 0.6, 0.5)),
            "moved by up to 10.0 cm; no finger touched",
        ),
        (
            make_film(steps=0, state=places(0.5), outcome=Outcome.LEFT_WORKSPACE),
            "left the workspace at step 0; no finger touched",
        ),
        (
            make_film("pushing", touching=(2,), state=places(0.4, 0.4, 0.5, 0.5, 0.5)),
            "object to target 10.0 cm at best, the goal is 7 cm",
        ),
        (make_film(touching=(4,), outcome=Outcome.SUCCESS), "Success at step 4; .* in 1 of 4"),
    ],
)
def test_the_likely_reason_is_said_in_words(film, words):
    assert re.search(words, ending_in_words(film))
    assert ending_in_words(film, "NaN").endswith("s: NaN")


def test_the_table_has_the_reset_and_each_step_with_units(hac):
    film = make_film(touching=(3,))
    rows = list(csv.DictReader(io.StringIO(episode_csv(hac, film))))
    trace = film.played.trace
    assert [row["time_s"] for row in rows] == ["0.0", "0.25", "0.5", "0.75", "1.0"]
    assert [row["contact_ticks"] for row in rows] == ["", "0", "0", "60", "0"]
    assert float(rows[2]["left_opening_mm"]) == pytest.approx(40 * trace.touch[2, 3], abs=1e-5)
    assert float(rows[4]["right_force_z_N"]) == pytest.approx(trace.touch[4, 10], abs=1e-5)
    assert float(rows[1]["action_fingers"]) == pytest.approx(trace.actions[0, 3], abs=1e-5)
    assert not [name for name in rows[0] if name == "action_yaw" or name.startswith("given_")]


def test_a_page_holds_every_picture_and_takes_no_name_for_markup(hostile):
    html = episode_page(ReplayedEpisode(hostile, make_film(touching=(2,)), False)).html
    assert "<script>alert" not in html
    assert "not the recorded episode" in html
    (found,) = re.findall(r'id="episode">(.*?)</script>', html)
    (data,) = json.loads(found)["tracks"]
    assert (data["scenes"]["count"], data["images"]["count"]) == (5, 4)
    assert [mark["text"] for mark in data["marks"]] == ["first touch", "touched, but failed"]
    assert data["marks"][0]["time"] == 0.25


def test_a_notebook_shows_the_page_in_a_frame_of_its_own(hac):
    page = episode_page(ReplayedEpisode(hac, make_film(steps=0), True))  # the policy failed at once
    assert page._repr_html_().startswith("<iframe title=")
    assert "<script" not in page._repr_html_()
