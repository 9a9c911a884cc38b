"""A study's method as a submission: nothing is played again, and every check passes."""

import hashlib
import shutil
import tomllib
from dataclasses import replace

import pytest

from minitouch_bench.agents.config import CONFIG_FILE
from minitouch_bench.documents import write_json, write_toml
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.leaderboard.validation import validate
from minitouch_bench.protocol.minitouch import GOAL_TASKS, TASK_NAMES
from minitouch_bench.workflows.study_config import STUDY_FILE, StudyConfig, TaskGrid
from minitouch_bench.workflows.submit import submit
from tests.cli.command import run
from tests.leaderboard.synthetic import make_submission, official_run, task_run, write_official

CONFIG = StudyConfig(
    methods=("hac", "sac"),
    tasks=TASK_NAMES,
    seeds=(0, 1),
    exploration_steps=(10_000,),
    task_steps=500,
)


def digest(content):
    return hashlib.sha256(content).hexdigest()


def make_study(directory, config=CONFIG):
    directory.mkdir()
    (directory / STUDY_FILE).write_bytes(write_json(config))
    for training in config.trainings():
        place, task = directory / training.name, training.task
        place.mkdir()
        (place / CONFIG_FILE).write_text(write_toml(config.config_of(training)))
        played = task_run(official_run(seed=training.seed, exploration=True), task)
        header = replace(played.header, exploration=None)
        for role, name in (("policy", "final"), ("exploration", "exploration")):
            explores = training.method != "sac" and training.exploration_steps
            if role == "exploration" and not (explores and task in GOAL_TASKS):
                continue
            content = f"{name} of {training.name}".encode()
            (place / f"{name}.safetensors").write_bytes(content)
            identity = replace(played.header.policy, digest=digest(content))
            header = replace(header, **{role: identity})
        records = tuple(
            record
            for record in played.records
            if header.exploration or record.spec.role.value == "final"
        )
        write_official(replace(played, header=header, records=records), place / "table4")
    return directory


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    directory = make_study(tmp_path_factory.mktemp("study") / "s")
    videos = directory / "opening-hac-10000-0" / "table4" / "videos"
    videos.mkdir()
    (videos / "opening-3.mp4").write_bytes(b"a video")
    return directory


def test_a_method_is_packed_with_the_policies_of_all_its_seeds(study, tmp_path):
    done = run("submit", study, "--method", "hac", directory=tmp_path)
    assert (done.code, done.out) == (0, "submissions/hac\n"), done.err
    place = tmp_path / "submissions" / "hac"
    assert not validate(place).problems
    told = tomllib.loads((place / "submission.toml").read_text())
    assert (told["method"], told["training_steps"]) == ("hac", 4 * 10_000 + 3 * 500)
    assert [seed["seed"] for seed in told["seeds"]] == [0, 1]
    files = sorted(path.relative_to(place).as_posix() for path in place.rglob("*.safetensors"))
    assert len(files) == 2 * (4 + 3)
    (video,) = place.rglob("*.mp4")
    assert video.relative_to(place).as_posix() == "seed-0/table4/videos/opening-3.mp4"
    explored = place / "checkpoints/seed-1/exploration/opening.safetensors"
    assert explored.read_bytes() == b"exploration of opening-hac-10000-1"
    text = (place / "seed-0/table4/run.json").read_text()
    assert '"source": "submissions/hac/checkpoints/seed-0/final"' in text
    assert str(study) not in text


def test_a_method_without_exploration_has_no_exploration_policies(study, tmp_path):
    packed = submit(str(study), method="sac", directory=tmp_path)
    assert packed.problems == ()
    assert not [*tmp_path.rglob("exploration")]


def test_a_submission_that_is_there_is_replaced_as_a_whole(study, tmp_path):
    submit(str(study), method="hac", directory=tmp_path, training_steps=1)
    with pytest.raises(RunDirectoryError, match="Add --fresh to replace it"):
        submit(str(study), method="hac", directory=tmp_path)
    submit(str(study), method="hac", directory=tmp_path, fresh=True)
    told = tomllib.loads((tmp_path / "hac" / "submission.toml").read_text())
    assert told["training_steps"] == 4 * 10_000 + 3 * 500


def test_a_submission_is_replaced_by_all_training_seeds_or_by_none(tmp_path):
    study = make_study(tmp_path / "s", replace(CONFIG, methods=("hac",)))
    submit(str(study), method="hac", directory=tmp_path)
    before = {file: file.read_bytes() for file in (tmp_path / "hac").rglob("*") if file.is_file()}
    for training in study.glob("*-1"):  # seed 1 becomes a copy of seed 0
        config = (training / CONFIG_FILE).read_bytes()
        shutil.rmtree(training)
        shutil.copytree(f"{str(training)[:-1]}0", training)
        (training / CONFIG_FILE).write_bytes(config)
    with pytest.raises(RunDirectoryError, match="no other copy of it is known"):
        submit(str(study), method="hac", directory=tmp_path, fresh=True, notes="new")
    after = {file: file.read_bytes() for file in (tmp_path / "hac").rglob("*") if file.is_file()}
    assert after == before


def test_a_submission_with_other_training_seeds_is_not_mixed_in(study, tmp_path):
    make_submission(tmp_path, "hac", seeds=(7,))
    with pytest.raises(RunDirectoryError, match="training seed 7, which the study lacks"):
        submit(str(study), method="hac", directory=tmp_path, fresh=True)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, r"choose .* --method; with every task it has hac, sac"),
        ({"method": "rnd"}, r"choose .* --method"),
        ({"method": "hac", "training_seed": 1}, "its own exploration policies and training seeds"),
        ({"method": "hac", "exploration": "random"}, "its own exploration policies"),
        ({"method": "hac", "suites": "table4,novel-shapes"}, "has no run of novel-shapes"),
    ],
)
def test_what_a_study_cannot_give_is_named(study, tmp_path, options, words):
    with pytest.raises(UsageError, match=words):
        submit(str(study), directory=tmp_path, **options)


@pytest.fixture
def small(tmp_path):
    return make_study(tmp_path / "s", replace(CONFIG, methods=("hac",), seeds=(0,)))


def refused(study, tmp_path):
    with pytest.raises((UsageError, RunDirectoryError)) as caught:
        submit(str(study), method="hac", directory=tmp_path / "submissions")
    assert not [*tmp_path.rglob("submission.toml")]
    return str(caught.value)


def test_exploration_in_some_goal_tasks_alone_is_refused(tmp_path):
    tasks = {"pushing": TaskGrid(exploration_steps=(0,))}
    config = replace(CONFIG, methods=("hac",), seeds=(0,), per_task=tasks)
    with pytest.raises(UsageError, match=r"hac explored in .*opening.* alone"):
        submit(str(make_study(tmp_path / "s", config)), method="hac", directory=tmp_path)


def test_a_training_that_was_changed_is_refused(small, tmp_path):
    place = small / "opening-hac-10000-0"
    explored, final = (place / f"{name}.safetensors" for name in ("exploration", "final"))
    explored.write_bytes(b"another one")
    assert "table4 is of another policy" in refused(small, tmp_path)
    explored.unlink()
    assert "table4 is of another policy" in refused(small, tmp_path)
    final.write_bytes(b"another one")
    assert "table4 is of another policy" in refused(small, tmp_path)
    config = place / CONFIG_FILE
    config.write_text(config.read_text().replace("discount = 0.95", "discount = 0.9"))
    assert "other settings than the study" in refused(small, tmp_path)
    (place / "failure.txt").write_text("a full disk\n")
    assert "a full disk" in refused(small, tmp_path)


def test_a_study_that_is_not_done_or_not_official_is_refused(small, tmp_path):
    (small / "opening-hac-10000-0" / "table4" / "run.json").unlink()
    assert "opening-hac-10000-0 has no run of table4" in refused(small, tmp_path)
    few = replace(CONFIG, methods=("hac",), seeds=(0,), episodes=50)
    (small / STUDY_FILE).write_bytes(write_json(few))
    assert "50 episodes per task: it is not official" in refused(small, tmp_path)
