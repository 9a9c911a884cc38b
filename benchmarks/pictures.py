"""Draw the pictures that reports and the README show, from the tasks themselves."""

from pathlib import Path

import numpy as np
from PIL import Image

from minitouch_bench.policies.scripted import make_controller
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.registry import TASKS

REPORT_PICTURES = Path("minitouch_bench/rendering/pictures")
DOCUMENT_PICTURES = Path("docs/pictures")
WIDTH, HEIGHT = 640, 480
SMOOTHING = 2
"""Pixels drawn for each one kept, in both directions."""
VIDEO_WIDTH, VIDEO_HEIGHT = 240, 180
VIDEO_STEPS = 24
"""Control steps of the video; a task that ends earlier stays as it ended."""
FRAME_MS = 160

MOMENTS = {"playing": (3, 6), "pushing": (5, 8), "opening": (1, 15), "pick-up": (2, 9)}
"""Episode seed and control step of each picture."""


def main() -> None:
    """Write an image of each task, a strip of all with what a policy sees, and a video of all."""
    REPORT_PICTURES.mkdir(parents=True, exist_ok=True)
    DOCUMENT_PICTURES.mkdir(parents=True, exist_ok=True)
    strip = []
    for task in TASKS:
        picture, observed = draw(task)
        picture.quantize(128).save(REPORT_PICTURES / f"{task}.png", optimize=True)
        small = picture.resize((WIDTH // 2, HEIGHT // 2), Image.Resampling.LANCZOS)
        small.quantize(128).save(DOCUMENT_PICTURES / f"{task}.png", optimize=True)
        inset = Image.fromarray(observed).resize((168, 168), Image.Resampling.NEAREST)
        picture.paste((255, 255, 255), (WIDTH - 180, 8, WIDTH - 8, 180))
        picture.paste(inset.convert("RGB"), (WIDTH - 178, 10))
        strip.append(np.asarray(picture))
    joined = Image.fromarray(np.concatenate(strip, axis=1))
    half = joined.resize((joined.width // 2, joined.height // 2), Image.Resampling.LANCZOS)
    half.quantize(128).save(DOCUMENT_PICTURES / "tasks.png", optimize=True)
    write_video(DOCUMENT_PICTURES / "tasks.gif")


def write_video(file: Path) -> None:
    """Write a video of the scripted policy at all tasks side by side."""
    videos = [frames_of(task) for task in TASKS]
    frames = [Image.fromarray(np.concatenate(row, axis=1)) for row in zip(*videos, strict=True)]
    palette = frames[len(frames) // 2].quantize(96)
    first, *others = [frame.quantize(palette=palette, dither=0) for frame in frames]
    first.save(file, save_all=True, append_images=others, duration=FRAME_MS, loop=0, optimize=True)


def frames_of(task: str) -> list[np.ndarray]:
    """Return an image of each control step of an episode of the scripted policy."""
    environment = MiniTouchEnv(task, width=VIDEO_WIDTH * SMOOTHING, height=VIDEO_HEIGHT * SMOOTHING)
    environment.reset(seed=MOMENTS.get(task, (0, 5))[0])
    controller = make_controller(environment)
    images = []
    ended = False
    for _ in range(VIDEO_STEPS):
        large = Image.fromarray(environment.picture())
        images.append(
            np.asarray(large.resize((VIDEO_WIDTH, VIDEO_HEIGHT), Image.Resampling.LANCZOS))
        )
        if not ended:
            _, _, terminated, truncated, _ = environment.step(controller.act())
            ended = terminated or truncated
    environment.close()
    return images


def draw(task: str) -> tuple[Image.Image, np.ndarray]:
    """Return a picture of a task while the scripted policy is at it, and the policy's view."""
    seed, moment = MOMENTS.get(task, (0, 5))
    environment = MiniTouchEnv(task, width=WIDTH * SMOOTHING, height=HEIGHT * SMOOTHING)
    observation, _ = environment.reset(seed=seed)
    controller = make_controller(environment)
    for _ in range(moment):
        observation, _, terminated, _, _ = environment.step(controller.act())
        if terminated:
            break
    large = Image.fromarray(environment.picture())
    environment.close()
    return large.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS), observation["image"][0]


if __name__ == "__main__":
    main()
