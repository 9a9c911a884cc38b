"""A small study for real: two methods, one seed, a few steps; broken off, resumed, and failed."""

import json
import os
import shutil
import signal
import time

import pandas as pd
import pytest

from minitouch_bench.errors import RunDirectoryError, UsageError
from minitouch_bench.evaluation.engine import EngineOptions
from minitouch_bench.workflows import studying
from minitouch_bench.workflows.study_config import read_study
from minitouch_bench.workflows.studying import run_study
from tests.cli.command import finish, run, start

STUDY = """
methods = ["hac", "rnd"]
tasks = ["playing"]
seeds = [0]
exploration_steps = [60]
task_steps = 30
episodes = 1

[settings]
random_steps = 40
evaluate_every = 0
log_every = 20
sac = { batch_size = 8 }
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    root = tmp_path_factory.mktemp("study")
    (root / "small.toml").write_text(STUDY)
    directory = root / "reports" / "studies" / "small"
    found = run_study(read_study(root / "small.toml"), directory)
    assert (len(found.done), found.failed, found.left) == (2, {}, ())
    return directory


@pytest.mark.slow
def test_every_training_is_evaluated_under_the_protocol(finished):
    for method in ("hac", "rnd"):
        place = finished / f"playing-{method}-60-0" / "table4"
        document = json.loads((place / "run.json").read_text())
        assert [one["task"] for one in document["episodes"]] == ["playing"]
        assert not os.path.isabs(document["header"]["policy"]["source"])


@pytest.mark.slow
def test_a_task_with_a_goal_is_evaluated_after_exploration_too(tmp_path):
    text = STUDY.replace('"playing"', '"opening"').replace('"hac", "rnd"', '"rnd"')
    (tmp_path / "s.toml").write_text(text)
    found = run_study(read_study(tmp_path / "s.toml"), tmp_path / "out")
    (training,) = found.done
    document = json.loads((tmp_path / "out" / training.name / "table4/run.json").read_text())
    assert len(document["exploration_episodes"]) == len(document["episodes"]) == 1
    assert "Exploration" in (tmp_path / "out" / "report.md").read_text()


@pytest.mark.slow
def test_the_report_has_the_figures_of_the_runs(finished):
    estimates = pd.read_csv(finished / "estimates.csv")
    document = json.loads((finished / "playing-hac-60-0" / "table4" / "run.json").read_text())
    (summary,) = document["summary"]["tasks"]
    shown = estimates[estimates["method"] == "hac"].set_index("metric")
    for metric, estimate in summary["estimates"].items():
        for part in ("value", "low", "high"):
            assert shown.loc[metric, part] == estimate[part]
    curves = pd.read_csv(finished / "curves.csv")
    assert sorted(curves.loc[curves["task"] == "playing", "step"].unique()) == [20, 40, 60]
    report = (finished / "report.md").read_text()
    assert "exploration: Playing 60." in report
    assert "Claims" not in report  # this study makes none
    assert r"\begin{table}" in (finished / "tables.tex").read_text()
    for name in ("report.html", "figures/curves.svg", "figures/curves.pdf"):
        assert (finished / name).stat().st_size > 1000


@pytest.mark.slow
def test_what_is_done_is_not_done_again(finished):
    files = [*finished.rglob("*.safetensors"), *finished.rglob("run.json")]
    before = {path: path.stat().st_mtime_ns for path in files}
    root = finished.parents[2]
    done = run("study", "small.toml", directory=root)
    assert (done.code, done.out) == (0, "reports/studies/small/report.html\n"), done.err
    assert "2 of 2 trainings are done" in done.err
    assert "control steps" in done.err
    assert "120/120" in done.err
    assert {path: path.stat().st_mtime_ns for path in files} == before


@pytest.mark.slow
def test_what_is_missing_is_done_alone(finished):
    lost = finished / "playing-rnd-60-0" / "table4"
    before = (lost / "run.json").read_bytes()
    episodes = json.loads(before)["episodes"]
    policy = finished / "playing-rnd-60-0" / "final.safetensors"
    trained = policy.stat().st_mtime_ns
    for path in [
        *lost.iterdir(),
        policy.with_name("checkpoint.pt"),
        policy.with_name("replay.bin"),
    ]:
        path.unlink()
    config = read_study(finished.parents[2] / "small.toml")
    states = []
    run_study(config, finished, on_state=states.append)
    assert [[one.name for one in state.left] for state in states] == [["playing-rnd-60-0"], []]
    assert json.loads((lost / "run.json").read_text())["episodes"] == episodes
    assert policy.stat().st_mtime_ns == trained


@pytest.mark.slow
def test_a_study_may_grow_but_not_change(finished, tmp_path):
    file = tmp_path / "s.toml"
    file.write_text(STUDY.replace("episodes = 1", "episodes = 2"))
    with pytest.raises(RunDirectoryError, match="started with episodes = 1, the file has 2"):
        run_study(read_study(file), finished)
    file.write_text(STUDY.replace('"hac", "rnd"', '"hac"'))
    found = run_study(read_study(file), finished)
    assert [one.name for one in found.done] == ["playing-hac-60-0"]
    file.write_text(STUDY)
    found = run_study(read_study(file), finished)
    assert len(found.done) == 2


@pytest.mark.slow
def test_a_finished_training_of_other_settings_is_not_counted(finished, tmp_path):
    shutil.copytree(finished, tmp_path / "out")
    config = tmp_path / "out" / "playing-rnd-60-0" / "config.toml"
    config.write_text(config.read_text().replace("discount = 0.95", "discount = 0.9"))
    (tmp_path / "s.toml").write_text(STUDY)
    found = run_study(read_study(tmp_path / "s.toml"), tmp_path / "out")
    assert [one.method for one in found.done] == ["hac"]
    assert ["other settings" in why for why in found.failed.values()] == [True]


def test_a_task_that_no_suite_has_is_trained_all_the_same(tmp_path, monkeypatch):
    (tmp_path / "s.toml").write_text(STUDY.replace("task_steps", "suites = []\ntask_steps"))
    started = []
    monkeypatch.setattr(studying, "_run", lambda job: started.append(str(job)) or "not now")
    monkeypatch.setattr(studying, "find_job_runner", lambda _: run_here)
    run_study(read_study(tmp_path / "s.toml"), tmp_path / "out")
    assert started == ["playing-hac-60-0", "playing-rnd-60-0"]


def test_a_part_of_a_study_is_trained_and_the_report_is_of_all(tmp_path, monkeypatch):
    text = STUDY.replace('"playing"', '"playing", "opening"') + "[per_task.opening]\n"
    (tmp_path / "s.toml").write_text(text + 'methods = ["rnd", "sac"]\n')
    config = read_study(tmp_path / "s.toml")
    started = []
    monkeypatch.setattr(studying, "_run", lambda job: started.append(str(job)) or "not now")
    monkeypatch.setattr(studying, "find_job_runner", lambda _: run_here)
    wanted = config.select(tasks=["opening"], methods=["rnd", "hac"])
    found = run_study(config, tmp_path / "out", wanted=wanted)
    assert started == ["opening-rnd-60-0"]
    assert len(found.trainings) == 4
    found = run_study(config, tmp_path / "out", wanted=config.select([], ["sac"]))
    assert started[1:] == ["opening-sac-60-0"]
    assert {one.name for one in found.failed} == {"opening-rnd-60-0", "opening-sac-60-0"}


@pytest.mark.parametrize(
    ("tasks", "methods", "words"),
    [
        (["pushing"], [], "no task 'pushing', only playing"),
        ([], ["hacc"], "no method 'hacc', only rnd, hac"),
        (["playing"], ["hac"], "none of these methods in these tasks"),
    ],
)
def test_a_part_that_a_study_does_not_have(tmp_path, tasks, methods, words):
    text = STUDY.replace('"playing"', '"playing", "opening"') + "[per_task.playing]\n"
    (tmp_path / "s.toml").write_text(text + 'methods = ["rnd"]\n')
    with pytest.raises(UsageError, match=words):
        read_study(tmp_path / "s.toml").select(tasks, methods)


def run_here(_, work, jobs):
    for job in jobs:
        yield job, work(job)


@pytest.mark.slow
def test_killed_twice_it_ends_in_the_same_rows(finished, tmp_path):
    (tmp_path / "small.toml").write_text(
        STUDY.replace("log_every", "checkpoint_every = 20\nlog_every")
    )
    directory = tmp_path / "reports" / "studies" / "small"
    for method in ("hac", "rnd"):
        kill_once_there_is(directory / f"playing-{method}-60-0" / "checkpoint.pt", tmp_path)
    done = run("study", "small.toml", directory=tmp_path)
    assert done.code == 0, done.err
    assert (directory / "estimates.csv").read_text() == (finished / "estimates.csv").read_text()


def kill_once_there_is(file, directory):
    process = start("study", "small.toml", directory=directory)
    while not file.exists():
        assert process.poll() is None, finish(process).err
        time.sleep(0.02)
    process.kill()
    process.communicate()


@pytest.mark.slow
def test_a_training_that_fails_is_named_and_does_not_stop_the_others(tmp_path):
    (tmp_path / "s.toml").write_text(STUDY)
    bad = tmp_path / "out" / "playing-hac-60-0"
    bad.mkdir(parents=True)
    (bad / "config.toml").write_text("seed = 7\n")  # of another training
    (bad / "checkpoint.pt").write_bytes(b"")
    done = run("study", "s.toml", "--output", "out", directory=tmp_path)
    assert done.code == 5
    assert "playing-hac-60-0 failed: " in done.err.splitlines()[-1]
    assert "other settings" in done.err
    assert (tmp_path / "out" / "playing-rnd-60-0" / "table4" / "run.json").exists()
    assert "playing-hac-60-0 failed" in (tmp_path / "out" / "report.md").read_text()


@pytest.mark.slow
def test_a_ray_cluster_gives_the_same_study(finished, tmp_path):
    pytest.importorskip("ray")
    (tmp_path / "s.toml").write_text(STUDY)
    done = run("study", "s.toml", "--output", "out", "--engine", "ray", directory=tmp_path)
    assert (done.code, done.out) == (0, "out/report.html\n"), done.err
    assert (tmp_path / "out/estimates.csv").read_text() == (finished / "estimates.csv").read_text()


@pytest.mark.slow
def test_a_training_whose_worker_is_killed_does_not_stop_the_others(tmp_path, monkeypatch):
    monkeypatch.setattr(studying, "_run", DyingWorker("hac"))
    (tmp_path / "s.toml").write_text(STUDY)
    found = run_study(read_study(tmp_path / "s.toml"), tmp_path / "out")
    assert [one.method for one in found.done] == ["rnd"]
    assert [why.split(":")[0] for why in found.failed.values()] == [
        "playing-hac-60-0 failed 3 times"
    ]


class DyingWorker:
    """Trains, except for a method whose worker dies each time."""

    def __init__(self, method):
        self._method, self._train = method, studying._run

    def __call__(self, job):
        if job.training.method == self._method:
            os.kill(os.getpid(), signal.SIGKILL)
        return self._train(job)


def test_there_are_two_engines(tmp_path):
    (tmp_path / "s.toml").write_text(STUDY)
    config = read_study(tmp_path / "s.toml")
    with pytest.raises(UsageError, match="no engine 'slurm'; there are local, ray"):
        run_study(config, tmp_path / "out", EngineOptions("slurm"))


CLAIM = """
[[claims]]
tasks = ["playing"]
metric = "touch_share"
better = "hac"
worse = ["rnd"]
"""


def claim_on(worse, metric):
    return CLAIM.replace("rnd", worse).replace("touch_share", metric) + "[settings]"


def test_a_task_may_have_its_own_methods_lengths_and_suites(tmp_path):
    (tmp_path / "s.toml").write_text(
        STUDY.replace('["playing"]', '["playing", "pushing"]')
        + "[per_task.pushing]\nmethods = ['sac']\nexploration_steps = [10, 20]\ntask_steps = 70\n"
    )
    config = read_study(tmp_path / "s.toml")
    assert [one.name for one in config.trainings()] == [
        "playing-hac-60-0", "playing-rnd-60-0", "pushing-sac-10-0", "pushing-sac-20-0",
    ]  # fmt: skip
    assert [config.config_of(one).task_phase.steps for one in config.trainings()] == [0, 0, 70, 70]


@pytest.mark.slow
def test_final_policies_play_under_other_conditions_too(finished, tmp_path):
    shutil.copytree(finished, tmp_path / "out")
    (tmp_path / "s.toml").write_text(
        STUDY + "[[conditions]]\nwithout = ['forces']\nperturb = ['mass=2:3']\nepisodes = 2\n"
        "methods = ['hac']\n"
    )
    found = run_study(read_study(tmp_path / "s.toml"), tmp_path / "out")
    assert (len(found.done), found.failed, found.left) == (2, {}, ())
    place = tmp_path / "out" / "playing-hac-60-0" / "without-forces-perturb-mass=2-to-3-2"
    plan = json.loads((place / "run.json").read_text())["header"]["plan"]
    assert (plan["episodes"], plan["conditions"]["without"]) == (2, ["forces"])
    assert not (tmp_path / "out" / "playing-rnd-60-0" / place.name).exists()
    report = (tmp_path / "out" / "report.md").read_text()
    assert "without forces, mass 2 to 3 times" in report
    estimates = pd.read_csv(tmp_path / "out" / "estimates.csv", keep_default_na=False)
    change = estimates.query("metric == 'touch_share, change'")
    assert "Touch share, change" in report
    # Both runs have episode 0.
    rows = [
        pd.read_csv(place.with_name(name) / "episodes.csv")["touch_share"][0]
        for name in (place.name, "table4")
    ]
    assert change[["method", "value"]].to_numpy().tolist() == [["hac", rows[0] - rows[1]]]
    # Table 4 is of the protocol's own conditions.
    before, after = (
        pd.read_csv(folder / "estimates.csv", keep_default_na=False)
        .query("conditions == ''")
        .reset_index(drop=True)
        for folder in (finished, tmp_path / "out")
    )
    pd.testing.assert_frame_equal(before, after)


@pytest.mark.slow
def test_claims_are_judged_once_their_trainings_are_done(finished, tmp_path):
    shutil.copytree(finished, tmp_path / "out")
    (tmp_path / "s.toml").write_text(STUDY.replace("[settings]", claim_on("rnd", "touch_share")))
    run_study(read_study(tmp_path / "s.toml"), tmp_path / "out")
    claims = pd.read_csv(tmp_path / "out" / "claims.csv")
    estimates = pd.read_csv(tmp_path / "out" / "estimates.csv")
    touched = estimates[estimates["metric"] == "touch_share"].set_index("method")["value"]
    assert claims["better_value"].tolist() == [touched["hac"]]
    assert claims["verdict"].tolist() == ["not decided"]  # one seed each
    assert "hac \\> rnd" in (tmp_path / "out" / "report.md").read_text()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("methods = ", "method = "), "methods"),
        (('"rnd"', '"rmd"'), "rmd"),
        (('"playing"', '"sleeping"'), "sleeping"),
        (("seeds = [0]", "seeds = ['0']"), "seeds"),
        (("episodes = 1", "epochs = 1"), "no key 'epochs'; it has methods, .* claims, conditions"),
        (("log_every", "log_each"), "log_each"),
        (("seeds", "suites = ['tables']\nseeds"), "tables"),
        (("seeds = [0]", "seeds = [0, 0]"), "one of its seeds twice"),
        (("[settings]", "[per_task.opening]\n[settings]"), "changes 'opening', which is not one"),
        (("[settings]", "[per_task.playing]\nseeds = [1]\n[settings]"), "seeds"),
        (("[settings]", "[per_task.playing]\nmethods = ['rmd']\n[settings]"), "rmd"),
        (("[settings]", "[[conditions]]\nwithout = ['smell']\n[settings]"), "smell"),
        (
            ("[settings]", "[[conditions]]\nwithout = ['touch']\nmethods = ['sac']\n[settings]"),
            "for 'sac'",
        ),
        (
            ("[settings]", "[[conditions]]\nwithout = ['touch']\ntasks = ['opening']\n[settings]"),
            "for 'opening'",
        ),
        (("[settings]", "[[conditions]]\n[settings]"), "needs 'without' or 'perturb'"),
        (("[settings]", 2 * CLAIM + "[settings]"), "claims twice"),
        (("[settings]", f"suites = []\n{claim_on('rnd', 'touch_share')}"), "does not play table4"),
        (("[settings]", claim_on("icm", "touch_share")), "icm in playing, and does not train it"),
        (("[settings]", claim_on("rnd", "success")), "no better direction in 'playing'"),
        (("[settings]", "[settings]\nseed = 1"), "sets 'seed' in its settings: use 'seeds'"),
        (
            ("[settings]", "[settings]\nexploration = { steps = 5 }"),
            "'exploration.steps' in its settings: use 'exploration_steps'",
        ),
        (("[settings]", "[settings"), "TOML"),
    ],
)
def test_mistakes_in_the_file_are_named(tmp_path, change, words):
    file = tmp_path / "s.toml"
    file.write_text(STUDY.replace(*change))
    with pytest.raises(UsageError, match=words):
        read_study(file)
