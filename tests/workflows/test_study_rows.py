"""A study's method as a submission: nothing is played again, and every check passes."""

import hashlib
import tomllib
from dataclasses import replace

import pytest

from minitouch_bench.agents.config import CONFIG_FILE
from minitouch_bench.documents import write_json, write_toml
from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.leaderboard.validation import validate
from minitouch_bench.protocol.minitouch import GOAL_TASKS, TASK_NAMES
from minitouch_bench.workflows.study_config import STUDY_FILE, StudyConfig
from minitouch_bench.workflows.submit import submit
from tests.cli.command import run
from tests.leaderboard.synthetic import official_run, task_run, write_official

CONFIG = StudyConfig(methods=("hac", "sac"), tasks=TASK_NAMES, seeds=(0, 1), task_steps=500)


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
            if role == "exploration" and (training.method == "sac" or task not in GOAL_TASKS):
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
    return make_study(tmp_path_factory.mktemp("study") / "s")


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
    explored = place / "checkpoints/seed-1/exploration/opening.safetensors"
    assert explored.read_bytes() == b"exploration of opening-hac-10000-1"
    assert str(tmp_path) not in (place / "seed-0/table4/run.json").read_text()


def test_a_method_without_exploration_has_no_exploration_policies(study, tmp_path):
    packed = submit(str(study), method="sac", directory=tmp_path)
    assert packed.problems == ()
    assert not [*tmp_path.rglob("exploration")]


def test_seeds_that_are_there_are_kept_or_replaced_as_asked(study, tmp_path):
    submit(str(study), method="hac", directory=tmp_path)
    with pytest.raises(RunDirectoryError, match="Add --resume to keep it"):
        submit(str(study), method="hac", directory=tmp_path)
    runs = [*tmp_path.rglob("run.json")]
    before = {path: path.stat().st_mtime_ns for path in runs}
    submit(str(study), method="hac", directory=tmp_path, resume=True)
    assert {path: path.stat().st_mtime_ns for path in runs} == before
    submit(str(study), method="hac", directory=tmp_path, fresh=True)
    assert len({path.stat().st_mtime_ns for path in runs} - {*before.values()}) == 2


@pytest.mark.parametrize("method", [None, "rnd"])
def test_a_method_of_the_study_must_be_chosen(study, tmp_path, method):
    with pytest.raises(UsageError, match=r"choose with --method .* methods are hac, sac"):
        submit(str(study), method=method, directory=tmp_path)


def test_a_study_that_is_not_done_or_was_changed_is_refused(tmp_path):
    study = make_study(tmp_path / "s", replace(CONFIG, methods=("sac",), seeds=(0,)))
    policy = study / "opening-sac-10000-0" / "final.safetensors"
    policy.write_bytes(b"another one")
    with pytest.raises(UsageError, match=r"of another policy than .*opening-sac-10000-0"):
        submit(str(study), method="sac", directory=tmp_path / "submissions")
    (policy.parent / "table4" / "run.json").unlink()
    with pytest.raises(UsageError, match="opening-sac-10000-0 has no run of table4"):
        submit(str(study), method="sac", directory=tmp_path / "submissions")
    assert not [*tmp_path.rglob("submission.toml")]
