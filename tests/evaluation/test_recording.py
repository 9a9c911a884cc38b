import subprocess

import numpy as np
import pytest
from PIL import Image

from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.evaluation.recording import video_name, write_video
from minitouch_bench.runs.plan import make_plan

PLAN = make_plan("smoke")


@pytest.fixture
def short(finished):
    """A pick-up and its first three actions."""
    spec = finished[0].header.specs()[4]
    return spec, finished[0].actions[spec.key][:3]


def test_an_mp4_has_a_frame_for_the_reset_and_for_each_step(short, tmp_path):
    pytest.importorskip("imageio.v2")
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    path = write_video(*short, tmp_path / "videos" / video_name(short[0].key), PLAN)
    assert path.name == "pick-up-0.mp4"
    # Not by imageio's reader: it leaves its pipes open where ffmpeg ends before it is closed.
    decode = [ffmpeg, "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(decode, capture_output=True, check=True).stdout
    frames = np.frombuffer(raw, np.uint8).reshape(-1, 480, 480, 3)
    assert len(frames) == 4
    assert frames[0].std() > 10


def test_a_gif_needs_no_extra_and_has_the_same_frames(short, tmp_path):
    with Image.open(write_video(*short, tmp_path / "video.gif", PLAN)) as picture:
        assert picture.n_frames == 4
        assert picture.size == (480, 480)


def test_another_kind_of_file_is_refused(short, tmp_path):
    with pytest.raises(UsageError, match=r"mp4 or a \.gif"):
        write_video(*short, tmp_path / "video.avi", PLAN)


def test_a_place_that_cannot_be_written_is_said(short, tmp_path):
    (tmp_path / "videos").write_text("no directory")
    with pytest.raises(RunDirectoryError, match="cannot be written"):
        write_video(*short, tmp_path / "videos" / "video.gif", PLAN)
