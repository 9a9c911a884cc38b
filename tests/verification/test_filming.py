"""Real episodes, filmed in the real simulator, and looked at in a real browser."""

import io
import subprocess
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from PIL import Image

import minitouch_bench as mt
from minitouch_bench.evaluation.engine import Callbacks
from minitouch_bench.evaluation.policy_setup import Recording
from minitouch_bench.perturbation import Perturbation
from minitouch_bench.reporting.viewer import ReplayedEpisode, episode_csv, episode_page
from minitouch_bench.runs.run import read_run
from minitouch_bench.verification.filming import (
    film_episode,
    film_run,
    write_video,
)
from tests.evaluation.runs import request, run

KEY = "pick-up/1"


@pytest.fixture(scope="module")
def scripted(tmp_path_factory):
    return run(request("scripted", ("opening", "pick-up")), tmp_path_factory.mktemp("scripted"))


@pytest.fixture(scope="module")
def steps(scripted):
    return len(scripted.actions_of(KEY))


@pytest.fixture(scope="module")
def page(scripted, tmp_path_factory):
    return mt.replay(scripted, KEY).save(tmp_path_factory.mktemp("viewer") / "pick-up.html")


@pytest.fixture
def viewer(browser, page):
    browser.open(page)
    return browser


def now(viewer):
    return viewer.run("document.getElementById('now').textContent")


def test_an_episode_is_stepped_through_played_and_scrubbed(viewer, steps):
    first = viewer.run("scenes.toDataURL()")
    assert now(viewer).startswith("reset")
    viewer.press("ArrowRight")
    viewer.press("ArrowRight")
    assert now(viewer).startswith(f"step 2 of {steps}")
    assert viewer.run("scenes.toDataURL()") != first
    viewer.press("End")
    assert now(viewer).startswith(f"step {steps} of {steps}")
    viewer.run("document.getElementById('speed').value = 4")
    viewer.click("#play")  # from the beginning, in a quarter of 1.9 s
    viewer.run("new Promise(done => { const look = () => play.textContent === 'Play' ? done() :"
                "setTimeout(look, 50); look(); })")  # fmt: skip
    assert now(viewer).startswith(f"step {steps} of {steps}")
    viewer.click(".plot svg")  # the middle of the first panel
    assert abs(int(now(viewer).split()[1]) - steps / 2) <= steps / 4
    assert viewer.messages == []
    assert {url[:5] for url in viewer.requests} <= {"file:", "data:"}


def test_the_policy_s_image_is_shown_as_it_was_given(viewer, scripted, steps):
    spec, _ = scripted.find(KEY)
    film = film_episode(Recording.of(scripted, [spec]), spec, (24, 24))
    assert film.scenes.shape == (steps + 1, 24, 24, 3)
    assert film.images.shape == (steps, 84, 84)
    viewer.press("ArrowRight")
    shown = viewer.run("[...images.getContext('2d').getImageData(0, 0, 84, 84).data]")
    gray = np.array(shown, np.uint8).reshape(84, 84, 4)[..., 0]
    np.testing.assert_array_equal(gray, film.images[1])


def test_no_text_lies_on_a_curve_each_limit_is_named_and_the_page_fits_a_phone(viewer):
    over = viewer.run(
        "[...document.querySelectorAll('.plot svg')].flatMap(svg => {"
        "const frame = svg.querySelector('.frame').getBBox();"
        "return [...svg.querySelectorAll('text')].filter(text => { const box = text.getBBox();"
        "return box.x + box.width > frame.x && box.y < frame.y + frame.height; }"
        ").map(text => text.textContent); })"
    )
    assert over == []
    heads = viewer.run("[...document.querySelectorAll('.plot h2')].map(one => one.textContent)")
    assert [("limit 200 N" in head, "goal 5 cm" in head) for head in heads] == [
        (True, False), (True, False), *[(False, False)] * 4, (False, True),
    ]  # fmt: skip
    viewer.screen(390, 800)
    viewer.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert viewer.run("document.documentElement.scrollWidth") <= 390


def test_the_weight_of_a_finger_is_felt_in_free_air(scripted):
    for key, axis in ((KEY, 2), ("opening/0", 0)):
        spec, _ = scripted.find(key)
        trace = film_episode(Recording.of(scripted, [spec]), spec, (8, 8)).played.trace
        forces = trace.touch[1, 5:].reshape(2, 3)
        assert np.abs(forces[:, axis]).round(1).tolist() == [1.0, 1.0]
        assert not trace.touch[0, 5:].any()


@pytest.mark.parametrize(
    ("conditions", "first_given"),
    [
        (Perturbation(without=("forces",)), "left_force_x_N"),
        (Perturbation(force_noise=20.0), "left_force_x_N"),
        (Perturbation(without=("touch",)), "end_effector_x_m"),
        (Perturbation(delay=(2, 2)), "end_effector_x_m"),
    ],
)
def test_what_the_policy_was_given_is_shown_beside_the_truth(
    browser, tmp_path, conditions, first_given, scripted
):
    plan = replace(scripted.plan, conditions=conditions)
    altered = replace(scripted, header=replace(scripted.header, plan=plan))
    page = tmp_path / "page.html"
    spec, _ = scripted.find(KEY)
    film = film_episode(Recording.of(altered, [spec]), spec)
    episode_page(ReplayedEpisode(altered, film, is_as_recorded=True)).save(page)
    truth = film.played.trace.touch[:, 5:]
    rows = pd.read_csv(io.StringIO(episode_csv(altered, film)))
    given = [name for name in rows if name.startswith("given_")]
    forces = rows[given[-6:]].to_numpy()
    assert given[0] == f"given_{first_given}"
    np.testing.assert_allclose(rows.loc[:, "left_force_x_N":"right_force_z_N"], truth, atol=1e-5)
    assert np.isnan(forces[-1]).all()  # no action follows
    if conditions.without:
        assert (forces[:-1] == 0).all()  # as at the reset
    elif conditions.delay == (2, 2):
        np.testing.assert_allclose(forces[2:-1], truth[:-3], atol=1e-5)
    else:
        assert 10 < (forces - truth)[:-1].std() < 30
    browser.open(page)
    drawn = browser.run("document.querySelectorAll('.faint').length")
    assert drawn == (8 if conditions.changes_touch else 6)
    shown = browser.run("document.querySelector('.plot h2 b').textContent.slice(-3)")
    assert f"{forces[0, 0]:.1f}".endswith(shown)


def test_the_image_before_a_fault_is_shown_as_the_policy_was_given_it(scripted):
    spec, _ = scripted.find(KEY)
    recording = Recording.of(scripted, [spec])
    for count in (0, 2):
        broken_off = replace(recording, actions={spec: recording.actions[spec][:count]})
        assert len(film_episode(broken_off, spec, (8, 8)).images) == count + 1
    plan = replace(scripted.plan, conditions=Perturbation(without=("vision",)))
    images = film_episode(replace(recording, plan=plan), spec, (8, 8)).images
    assert (images == images[0]).all()


def test_failures_come_first_and_the_first_episodes_on_video(whole, tmp_path):
    run, said, filmed = read_run(whole), [], []
    failed = replace(run, rows=tuple(replace(row, outcome="step_limit") if row.index else row
                                     for row in run.rows))  # fmt: skip
    callbacks = Callbacks(note=said.append, episode=lambda one: filmed.append(one.spec.key))
    film_run(failed, tmp_path, videos=1, replays=1, workers=2, callbacks=callbacks)
    written = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.glob("*/*"))
    assert written == [
        "replays/opening-1.html", "replays/pushing-1.html",
        "videos/exploration-opening-0.mp4", "videos/exploration-pushing-0.mp4",
        "videos/opening-0.mp4", "videos/pushing-0.mp4",
    ]  # fmt: skip
    assert len(filmed) == 6
    assert "filming 6 episodes" in said[0]


@pytest.fixture(scope="module")
def film(scripted):
    """The first three steps of a pick-up."""
    spec, _ = scripted.find(KEY)
    return film_episode(Recording({spec: scripted.actions_of(KEY)[:3]}, scripted.plan), spec)


def test_an_mp4_has_every_picture(film, tmp_path):
    pytest.importorskip("imageio.v2")
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    path = tmp_path / "videos" / "pick-up-0.mp4"
    write_video(film, path)
    # Not by imageio's reader: it leaves its pipes open where ffmpeg ends before it is closed.
    decode = [ffmpeg, "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(decode, capture_output=True, check=True).stdout
    frames = np.frombuffer(raw, np.uint8).reshape(-1, 240, 240, 3)
    assert len(frames) == 4


def test_a_gif_needs_no_extra_and_has_the_same_pictures(film, tmp_path):
    write_video(film, tmp_path / "video.gif")
    with Image.open(tmp_path / "video.gif") as picture:
        assert (picture.n_frames, picture.size) == (4, (240, 240))
