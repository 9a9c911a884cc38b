"""Where a run's policy comes from, as files beside it say."""

import hashlib
from dataclasses import replace

import pytest

from minitouch_bench.agents.config import TrainingConfig
from minitouch_bench.documents import write_toml
from minitouch_bench.policies.sources import KEPT_FILE
from minitouch_bench.reporting.labels import RunOrigin
from minitouch_bench.workflows.report import find_origin, report
from tests.reporting.synthetic import make_run, save, write


@pytest.fixture
def training(tmp_path):
    """A training's directory with its settings alone."""
    directory = tmp_path / "training"
    directory.mkdir()
    (directory / "config.toml").write_text(write_toml(TrainingConfig("pushing", method="rnd")))
    return directory


def run_of(source, **identity):
    run = save(make_run("a", tasks=("pushing",), episodes=2, exploration=False))
    policy = replace(run.header.policy, source=str(source), **identity)
    return replace(run, header=replace(run.header, policy=policy))


def test_a_policy_of_a_training_directory_has_its_method_and_steps(training, tmp_path):
    place = tmp_path / "reports" / "run"
    assert find_origin(place, run_of(training / "final.safetensors")) == RunOrigin("rnd", 50_000)
    explored = run_of(training / "exploration.safetensors")
    assert find_origin(place, explored) == RunOrigin("rnd", 10_000)


def test_the_policy_of_a_training_that_was_made_longer_has_its_own_steps(training, tmp_path):
    kept = training / KEPT_FILE.format(30_000)
    kept.write_bytes(b"weights")
    (training / KEPT_FILE.format("x")).write_bytes(b"weights")
    digest = hashlib.sha256(b"weights").hexdigest()
    place = tmp_path / "reports" / "run"
    # Played before it had its name, and under it.
    for source in (training / "final.safetensors", kept, training):
        assert find_origin(place, run_of(source, digest=digest)) == RunOrigin("rnd", 30_000)
    assert find_origin(place, run_of(training / "final.safetensors")) == RunOrigin("rnd", 50_000)


def test_a_run_inside_a_training_directory_is_of_it(training):
    assert find_origin(training / "table4", run_of("gone.onnx")) == RunOrigin("rnd", 50_000)


def test_the_videos_of_a_run_are_in_its_report_however_it_is_named(tmp_path):
    write(make_run("a", tasks=("pushing",), episodes=2, exploration=False), tmp_path)
    (tmp_path / "videos").mkdir()
    (tmp_path / "videos" / "pushing-1.mp4").write_bytes(b"a video")
    for path in (tmp_path, tmp_path / "run.json"):
        assert report(path).directory == tmp_path
        assert "videos/pushing-1.mp4" in (tmp_path / "report.html").read_text()


def test_a_built_in_policy_comes_from_no_training(training, tmp_path, monkeypatch):
    monkeypatch.chdir(training)
    run = run_of("random")
    policy = replace(run.header.policy, kind="random", digest="")
    run = replace(run, header=replace(run.header, policy=policy))
    for place in (tmp_path / "reports" / "run", training / "table4"):
        assert find_origin(place, run) == RunOrigin()


def test_other_files_of_these_names_say_nothing(training, tmp_path):
    assert find_origin(tmp_path / "reports" / "run", run_of("a.onnx")) == RunOrigin()
    (training / "config.toml").write_text("[server]\nport = 1\n")
    assert find_origin(training / "table4", run_of("a.onnx")) == RunOrigin()
