"""Runs that are sent to a tracker: what is sent is read back."""

import csv
import json
import os
from importlib.util import find_spec

import pytest

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.workflows.experiment_log import log_run
from tests.cli.command import run
from tests.reporting.synthetic import make_run, save

ONE = ("evaluate", "scripted", "--episodes-from", "opening/0,2", "--workers", "1")


def test_tensorboard_has_the_figures_and_the_episodes(tmp_path):
    pytest.importorskip("tensorboardX")
    from tensorboardX.proto.event_pb2 import Event
    from tensorboardX.record_writer import masked_crc32c

    done = run(*ONE, "--log", "tensorboard", "--output", "run", directory=tmp_path)
    assert done.code == 0, done.err
    (file,) = (tmp_path / "run" / "tensorboard").iterdir()
    content, found = file.read_bytes(), {}
    while content:
        size = int.from_bytes(content[:8], "little")
        assert masked_crc32c(content[:8]) == int.from_bytes(content[8:12], "little")
        event = Event.FromString(content[12 : 12 + size])
        found |= {(one.tag, event.step): one.simple_value for one in event.summary.value}
        content = content[16 + size :]
    estimate = json.loads((tmp_path / "run" / "run.json").read_text())["summary"]["tasks"][0][
        "estimates"
    ]["success"]
    assert found["opening/success", 0] == estimate["value"] == 1.0
    assert found["opening/success_low", 0] == pytest.approx(estimate["low"])
    with (tmp_path / "run" / "episodes.csv").open(encoding="utf-8") as rows:
        for row in csv.DictReader(rows):
            assert found["opening/episodes/steps", int(row["index"])] == float(row["steps"])
            assert found["opening/episodes/success", int(row["index"])] == 1.0
    fresh = run(*ONE, "--output", "run", "--fresh", directory=tmp_path)
    assert fresh.code == 0
    assert "tensorboard" not in os.listdir(tmp_path / "run")


@pytest.mark.skipif(find_spec("wandb") is None, reason="needs the extra wandb: it is missing")
def test_wandb_offline_has_the_figures_and_the_episodes(tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_MODE", "offline")
    done = run(*ONE, "--log", "wandb", "--output", "run", directory=tmp_path)
    assert done.code == 0, done.err
    (table,) = (tmp_path / "wandb").glob("offline-run-*/files/media/table/episodes*.json")
    written = json.loads(table.read_text())
    assert [row[written["columns"].index("index")] for row in written["data"]] == [0, 2]
    (log,) = (tmp_path / "wandb").glob("offline-run-*/*.wandb")
    content = log.read_bytes()
    for name in (b"opening/success", b"opening/touch_share_low", b"minitouch-bench"):
        assert name in content


@pytest.mark.skipif(find_spec("wandb") is not None, reason="wandb is there")
def test_a_missing_tracker_is_named_before_the_first_episode(tmp_path):
    done = run(*ONE, "--log", "wandb", directory=tmp_path)
    done.refused(3, "minitouch-bench[wandb]")
    assert not (tmp_path / "reports").exists()


def test_an_unknown_tracker(tmp_path):
    run(*ONE, "--log", "comet", directory=tmp_path).refused(2, "'comet'", "tensorboard")


def test_a_tracker_that_fails_costs_no_run(tmp_path):
    pytest.importorskip("tensorboardX")
    (tmp_path / "tensorboard").write_text("in the way")
    finished = save(make_run(tasks=("pushing",), episodes=2))
    with pytest.raises(InfrastructureError, match=r"kept in .*tensorboard failed") as raised:
        log_run("tensorboard", finished, tmp_path)
    assert "--resume" in str(raised.value)
