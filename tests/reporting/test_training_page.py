import csv

import pandas as pd
import pytest

from minitouch_bench.reporting.training_page import EPISODES, episode_success, training_page

COLUMNS = (
    "step", "phase", "episodes", "intrinsic_reward", "task_reward", "touch_share", "force",
    "success", "curiosity_loss", "critic_loss", "actor_loss", "value", "entropy", "temperature",
    "evaluation_success", "evaluation_touch_share", "seconds",
)  # fmt: skip


@pytest.fixture
def directory(tmp_path):
    (tmp_path / "config.toml").write_text(
        'task = "pushing"\nmethod = "hac"\nseed = 7\nwithout = ["touch"]\nlog = "<script>"\n'
    )
    return tmp_path


def write_rows(directory, rows):
    with (directory / "progress.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="")
        writer.writeheader()
        writer.writerows(rows)


def row(step, phase, **values):
    basics = {
        "task_reward": 0.0,
        "touch_share": 0.1,
        "force": 4.0,
        "episodes": 5,
        "seconds": step / 10,
    }
    return {"step": step, "phase": phase, **basics, **values}


def test_every_curve_that_was_recorded_is_drawn(directory):
    rows = [row(500 * i, "exploration", curiosity_loss=1.0 / i, success=0.2) for i in range(1, 7)]
    rows += [row(500 * i, "task", critic_loss=-1.5, success=0.4) for i in range(7, 12)]
    write_rows(directory, rows)
    page = training_page(directory)
    for caption in ("Success", "Touch share", "Force, N", "Task reward per step", "Curiosity loss"):
        assert f"<figcaption>{caption}</figcaption>" in page
    assert "<figcaption>Entropy, nats</figcaption>" not in page
    assert "5,500 control steps in 9.2 minutes" in page
    assert "&lt;script&gt;" in page
    assert "<h1>Pushing, hac, seed 7, without touch</h1>" in page


def test_success_is_that_of_the_latest_episodes():
    rows = pd.DataFrame({"episodes": [10, 10, 10, 10], "success": [0.0, 1.0, 1.0, 0.5]})
    found = episode_success(rows)
    assert EPISODES == 20
    assert found.isna().tolist() == [True, False, False, False]
    assert found.tolist()[1:] == [0.5, 1.0, 0.75]
