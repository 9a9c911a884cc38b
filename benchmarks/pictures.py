"""Draw the pictures that reports and the README show, from the tasks themselves.

The video and the page of an episode are of policies that were trained by ``hac``: the checkpoints
of a submission play the episodes of its row again. The page needs Chromium (apt-get install
chromium).
"""

import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

import minitouch_bench as mt
from minitouch_bench.episode import Episode, EpisodeSpec, Role
from minitouch_bench.evaluation.policy_setup import Recording
from minitouch_bench.files import RESULTS, SUBMISSIONS
from minitouch_bench.policies.scripted import make_controller
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.task import TASK_CLASSES
from minitouch_bench.verification.filming import film_episode

REPORT_PICTURES = Path("minitouch_bench/reporting/pictures")
DOCUMENT_PICTURES = Path("docs/pictures")
WIDTH, HEIGHT = 640, 480
SMOOTHING = 2
"""Pixels drawn for each one kept, in both directions."""
VIDEO_WIDTH, VIDEO_HEIGHT = 240, 180
VIDEO_STEPS = 30
"""Control steps of the video; a task that ends earlier stays as it ended."""
FILMED = "hac/seed-30"
"""The training whose episodes are in the video, in ``submissions`` and in ``reports/results``."""
FRAME_MS = 160

PAGE_TASK, PAGE_ONSETS, PAGE_STEPS = "pick-up", 3, 25
"""The page shows a success of this task with as many touches, the longest within these steps."""

PAGE_SIZE = (1220, 1100)
"""Pixels of the page's picture."""

AT_LAST_STEP = """<script>
const seek = document.getElementById("seek");
seek.value = seek.max;
seek.dispatchEvent(new Event("input"));
</script></body>"""
"""Shows the end of the episode in place of its beginning."""

MOMENTS = {"playing": (3, 6), "pushing": (5, 8), "opening": (1, 15), "pick-up": (2, 9)}
"""Episode seed and control step of each picture."""


def main() -> None:
    """Write an image of each task, a strip of all with what a policy sees, and a video of all."""
    REPORT_PICTURES.mkdir(parents=True, exist_ok=True)
    DOCUMENT_PICTURES.mkdir(parents=True, exist_ok=True)
    strip = []
    for task in TASK_CLASSES:
        picture, observed = draw(task)
        picture.quantize(128).save(REPORT_PICTURES / f"{task}.png", optimize=True)
        inset = Image.fromarray(observed).resize((168, 168), Image.Resampling.NEAREST)
        picture.paste((255, 255, 255), (WIDTH - 180, 8, WIDTH - 8, 180))
        picture.paste(inset.convert("RGB"), (WIDTH - 178, 10))
        strip.append(np.asarray(picture))
    joined = Image.fromarray(np.concatenate(strip, axis=1))
    half = joined.resize((joined.width // 2, joined.height // 2), Image.Resampling.LANCZOS)
    half.quantize(128).save(DOCUMENT_PICTURES / "tasks.png", optimize=True)
    write_video(DOCUMENT_PICTURES / "tasks.gif")
    write_page(DOCUMENT_PICTURES / "viewer.png")


def write_video(file: Path) -> None:
    """Write a video of a trained policy at each task, side by side."""
    videos = [frames_of(task) for task in TASK_CLASSES]
    frames = [Image.fromarray(np.concatenate(row, axis=1)) for row in zip(*videos, strict=True)]
    palette = frames[len(frames) // 2].quantize(96)
    first, *others = [frame.quantize(palette=palette, dither=0) for frame in frames]
    first.save(file, save_all=True, append_images=others, duration=FRAME_MS, loop=0, optimize=True)


def frames_of(task: str) -> list[np.ndarray]:
    """Return an image of each control step of the longest episode that the video has room for.

    In a task with a goal it is one of those that succeed.
    """
    rows = [
        (spec, row)
        for spec, row in rows_of(task)
        if task not in GOAL_TASKS or (row.success and row.steps < VIDEO_STEPS)
    ]
    spec, run = play_longest(rows)
    actions = run.actions_of(spec.key)[: VIDEO_STEPS - 1]
    size = (VIDEO_WIDTH * SMOOTHING, VIDEO_HEIGHT * SMOOTHING)
    film = film_episode(Recording({spec: actions}, run.plan), spec, size)
    images = [np.asarray(shrink(image, VIDEO_WIDTH, VIDEO_HEIGHT)) for image in film.scenes]
    return images + images[-1:] * (VIDEO_STEPS - len(images))


def rows_of(task: str) -> list[tuple[EpisodeSpec, Episode]]:
    """Return the final policy's episodes of a task, as the row of FILMED has them."""
    pairs = mt.load_run(RESULTS / FILMED / "table4").specs_and_rows()
    return [pair for pair in pairs if pair[0].task == task and pair[0].role is Role.FINAL]


def play_longest(rows: list[tuple[EpisodeSpec, Episode]]) -> tuple[EpisodeSpec, mt.Run]:
    """Play the longest of these episodes again; return it with its run, which has the actions."""
    spec, _ = max(rows, key=lambda pair: pair[1].steps)
    policy = str(SUBMISSIONS / FILMED)
    return spec, mt.evaluate(policy, name="hac", episodes_from=[spec.key], progress=False)


def write_page(file: Path) -> None:
    """Draw the page of a pick-up in which the object was lost and found again."""
    rows = [
        (spec, row)
        for spec, row in rows_of(PAGE_TASK)
        if row.success and row.touch_onsets >= PAGE_ONSETS and row.steps <= PAGE_STEPS
    ]
    spec, run = play_longest(rows)
    with TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        html = mt.replay(run, spec.key).html.replace("Content-Security-Policy", "unused")
        page.write_text(html.replace("</body>", AT_LAST_STEP), encoding="utf-8")
        options = ("--headless", "--no-sandbox", "--hide-scrollbars", f"--screenshot={file}")
        size = ",".join(map(str, PAGE_SIZE))
        command = ["chromium", *options, f"--window-size={size}", page.as_uri()]
        subprocess.run(command, check=True, capture_output=True)
    Image.open(file).convert("RGB").quantize(128).save(file, optimize=True)


def shrink(image: np.ndarray, width: int, height: int) -> Image.Image:
    """Return an image that was drawn larger, in the size in which it is shown."""
    return Image.fromarray(image).resize((width, height), Image.Resampling.LANCZOS)


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
    picture = shrink(environment.picture(), WIDTH, HEIGHT)
    environment.close()
    return picture, observation["image"][0]


if __name__ == "__main__":
    main()
