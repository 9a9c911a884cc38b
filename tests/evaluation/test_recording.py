import subprocess

import numpy as np
import pytest
from PIL import Image

from minitouch_bench.evaluation.policy_setup import Recording
from minitouch_bench.verification.filming import film_episode, write_video


@pytest.fixture(scope="module")
def film(finished):
    """The first three steps of a pick-up."""
    run, _ = finished
    spec = run.header.specs()[4]
    return film_episode(Recording({spec: run.actions[spec.key][:3]}, run.plan), spec)


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
