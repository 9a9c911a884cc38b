"""Videos of recorded episodes, made by replaying their actions."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.optional import require
from minitouch_bench.records import EpisodeRecord
from minitouch_bench.tasks.registration import make_environment

FRAMES_PER_SECOND = 8
"""A control step lasts about a quarter of a second: videos run at twice real time."""


def film(record: EpisodeRecord, directory: Path) -> Path:
    """Replay one episode in front of the camera and return its ``.mp4``.

    Raises:
        MissingExtraError: the extra ``video`` is not installed.
        RunDirectoryError: the file cannot be written.
    """
    writer = require("imageio.v2", "video")
    require("imageio_ffmpeg", "video")
    path = directory / f"{record.spec.key.replace('/', '-')}.mp4"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with writer.get_writer(path, fps=FRAMES_PER_SECOND, macro_block_size=16) as video:
            for frame in _frames(record):
                video.append_data(frame)
    except OSError as error:
        raise RunDirectoryError(f"{path} cannot be written: {error.strerror}") from error
    return path


def _frames(record: EpisodeRecord) -> Iterator[NDArray[np.uint8]]:
    spec = record.spec
    environment = make_environment(spec.task, render_mode="rgb_array")
    options: dict[str, Any] | None = {"object": spec.shape} if spec.shape else None
    try:
        environment.reset(seed=spec.seed, options=options)
        yield environment.picture()
        for action in record.trace.actions:
            environment.step(action)
            yield environment.picture()
    finally:
        environment.close()
