from dataclasses import replace

import pytest

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.protocol.filming import film
from minitouch_bench.records import EpisodeTrace

imageio = pytest.importorskip("imageio.v2")
pytest.importorskip("imageio_ffmpeg")


@pytest.fixture
def short(finished):
    """A record of a pick-up, cut to its first steps."""
    record = finished[0].records[4]
    trace = record.trace
    return replace(record, trace=EpisodeTrace(trace.actions[:3], *list(vars(trace).values())[1:]))


def test_a_video_has_a_frame_for_the_reset_and_for_each_step(short, tmp_path):
    path = film(short, tmp_path / "videos")
    assert path.name == "pick-up-0.mp4"
    with imageio.get_reader(path) as video:
        frames = [video.get_data(index) for index in range(video.count_frames())]
    assert len(frames) == 4
    assert frames[0].shape == (480, 480, 3)
    assert frames[0].std() > 10


def test_a_place_that_cannot_be_written_is_said(short, tmp_path):
    (tmp_path / "videos").write_text("no directory")
    with pytest.raises(RunDirectoryError, match="cannot be written"):
        film(short, tmp_path / "videos")
