"""What a submission may hold, and every attack on it that is known, each refused by name."""

import io
import os
import pickle
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from minitouch_bench.leaderboard.validation import validate
from minitouch_bench.runs.run import parse_run, run_digest
from tests.altered import edit_actions, edit_document
from tests.leaderboard.synthetic import make_submission, official_run, write_official

RUN = "seed-0/table4"


def refused(directory: Path, *words: str) -> list[str]:
    """Check that the submission is refused and that one line holds all of these words."""
    lines = [str(problem) for problem in validate(directory).problems]
    assert any(all(word in line for word in words) for line in lines), lines
    assert not any("\n" in line or len(line) > 1300 for line in lines)
    return lines


def edit_run(directory: Path, change, run=RUN, *, seal=False) -> None:
    """Change the document of a run; with ``seal`` its digest is made to agree again."""
    file = directory / run / "run.json"
    edit_document(file, change)
    if seal:
        saved = parse_run(file.read_bytes(), "x")
        digest = run_digest(saved.header, saved.rows, saved.exploration_rows)
        edit_document(file, lambda document: document.update(digest=digest))


def edit_toml(directory: Path, old: str, new: str) -> None:
    file = directory / "submission.toml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


# What is sound


def test_a_sound_submission_has_no_fault(sound):
    verdict = validate(sound)
    assert verdict.problems == ()
    assert verdict.passed
    assert set(verdict.runs) == {RUN}


def test_several_seeds_suites_and_policy_faults_are_sound(tmp_path):
    both = ("table4", "novel-shapes")
    directory = make_submission(tmp_path, "multi", seeds=(0, 7), suites=both, faults=3)
    verdict = validate(directory)
    assert verdict.problems == ()
    assert set(verdict.runs) == {f"seed-{seed}/{suite}" for seed in (0, 7) for suite in both}


@pytest.mark.parametrize("kind", ["random", "zero", "scripted", "remote"])
def test_policies_without_a_file_are_sound(tmp_path, kind):
    name = "host" if kind == "remote" else kind
    assert validate(make_submission(tmp_path, name, kind=kind)).problems == ()


def test_checkpoints_need_not_be_included(tmp_path):
    directory = make_submission(tmp_path, include=False)
    assert not (directory / "checkpoints").exists()
    assert validate(directory).problems == ()


def test_an_empty_submission_file_is_a_fault(submission):
    (submission / "submission.toml").write_bytes(b"")
    verdict = validate(submission)
    assert not verdict.passed
    assert "its format is not 'minitouch-submission'" in str(verdict.problems[0])


def test_every_fault_is_told_at_once(submission):
    edit_toml(submission, 'method = "HaC, retrained"', 'method = "<b>bold</b>"')
    edit_toml(submission, 'paper = "https://', 'paper = "http://')
    edit_run(submission, lambda run: run["episodes"].pop())
    (submission / "extra.txt").write_text("hello")
    found = "\n".join(refused(submission, "submission.toml", "method"))
    for words in ("paper", "1 episode is missing", "extra.txt"):
        assert words in found


# Figures


def test_edited_metrics_in_run_json(submission):
    def change(run):
        run["episodes"][0]["touch_interaction"] += 1

    edit_run(submission, change)
    refused(submission, RUN, "touch_interaction", "recorded")


def test_failures_turned_into_successes(submission):
    def change(run):
        failed = [e for e in run["episodes"] if e["outcome"] == "left_workspace"]
        for episode in failed:
            episode.update({"outcome": "success", "episode_return": 25.0})

    edit_run(submission, change)
    refused(submission, RUN, "digest: it is not that of the episodes")
    edit_run(submission, lambda run: None, seal=True)
    refused(submission, RUN, "success", "recorded")


def test_edited_estimates(submission):
    def change(run):
        run["summary"]["tasks"][1]["estimates"]["episode_steps"]["low"] *= 1 - 1e-8

    edit_run(submission, change)
    refused(submission, RUN, "summary.tasks[1].estimates.episode_steps.low")


def test_an_edited_touch_curve(submission):
    def change(run):
        run["summary"]["tasks"][0]["touch_curve"][50] += 9

    edit_run(submission, change)
    refused(submission, RUN, "touch curve of playing")


def test_a_touch_curve_that_no_step_can_have(submission):
    def change(run):
        curve = run["summary"]["tasks"][0]["touch_curve"]
        curve[50], curve[51] = curve[50] + 1e308, curve[51] - 1e308

    edit_run(submission, change)
    refused(submission, RUN, "a control step has 0 to 100 ticks")


@pytest.mark.parametrize("name", ["episodes.csv", "report.md", "report.html"])
def test_tables_and_pages_are_no_part_of_a_submission(submission, name):
    (submission / RUN / name).write_text("")
    refused(
        submission, f"{RUN}/{name}", "no such file", "make tables and pages with minitouch-bench"
    )


def test_keys_that_the_schema_does_not_know(submission):
    edit_run(submission, lambda run: run["header"].update(sponsor="somebody"))
    refused(submission, f"{RUN}, run.json", "unknown")


def test_figures_that_contradict_each_other(submission):
    edit_run(submission, lambda run: run["episodes"][3].update(steps=201))
    refused(submission, "playing/3", "201 of 200 steps")


# Actions


def test_missing_actions(submission):
    edit_actions(submission / RUN, lambda actions: actions.pop("pushing/17"))
    refused(submission, "actions.npz", "pushing/17", "missing")


def test_actions_of_another_length(submission):
    edit_actions(submission / RUN, lambda a: a.update({"pushing/3": a["pushing/3"][:-1]}))
    refused(submission, "actions.npz", "pushing/3", "steps")


@pytest.mark.parametrize("value", [1.5, np.nan])
def test_actions_beyond_their_range(submission, value):
    def change(actions):
        actions["opening/0"][0] = value

    edit_actions(submission / RUN, change)
    refused(submission, "actions.npz", "opening/0", "beyond -1 to 1")


def test_actions_of_episodes_that_do_not_exist(submission):
    edit_actions(submission / RUN, lambda a: a.update({"pushing/100": a["pushing/1"]}))
    refused(submission, "actions.npz", "pushing/100")


def test_actions_that_declare_more_than_they_hold(submission):
    file = submission / RUN / "actions.npz"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("pushing/0.npy", bytes(200_000_000))
    assert file.stat().st_size < 250_000
    refused(submission, "actions.npz", "declares 200000000 bytes")


def test_actions_with_a_pickle_inside(submission):
    class Boom:
        def __reduce__(self):
            return os.mkdir, ("executed",)

    content = io.BytesIO()
    np.save(content, np.array([Boom()], object), allow_pickle=True)
    with zipfile.ZipFile(submission / RUN / "actions.npz", "w") as archive:
        archive.writestr("pushing/0.npy", content.getvalue())
    refused(submission, "actions.npz", "an array of another kind")
    assert not Path("executed").exists()


# Episodes


def test_missing_hard_episodes(submission):
    def change(run):
        run["episodes"] = [
            e for e in run["episodes"] if e["task"] != "pushing" or e["outcome"] == "success"
        ]

    edit_run(submission, change, seal=True)
    refused(submission, "are missing: pushing/", "evaluate the whole suite")


def test_duplicate_episodes(submission):
    def change(run):
        run["episodes"][101] = run["episodes"][100]

    edit_run(submission, change, seal=True)
    refused(submission, "1 episode is there twice: pushing/0")
    refused(submission, "1 episode is missing: pushing/1")


def test_easier_seeds_and_shapes(submission):
    def change(run):
        run["episodes"][100]["seed"] = 1
        run["episodes"][300]["shape"] = run["episodes"][301]["shape"]

    edit_run(submission, change, seal=True)
    refused(submission, "another seed than the suite's: pushing/0")
    refused(submission, "another shape than the suite's: pick-up/0")


def test_another_order(submission):
    edit_run(submission, lambda run: run["episodes"].reverse(), seal=True)
    refused(submission, "not in the suite's order")


def test_an_unofficial_run_that_says_it_is_official(submission):
    def change(run):
        run["header"]["plan"]["seed"] = 3

    edit_run(submission, change)
    refused(submission, "the plan gives seed 3")


def test_another_suite_in_its_place(submission):
    edit_run(submission, lambda run: run["header"]["plan"].update(suite="smoke"))
    refused(submission, "it is a run of the suite 'smoke', not table4")


def test_another_protocol_s_run(submission):
    edit_run(submission, lambda run: run["header"]["task_digests"].update(pushing="0" * 64))
    verdict = validate(submission)
    assert verdict.is_other_protocol
    refused(submission, "the rules of pushing are not", "000000000000", "evaluate again")


def test_another_name_of_the_protocol(submission):
    def change(run):
        run["header"]["protocol"] = "minitouch-v2"
        run["header"]["task_digests"]["stacking"] = "0" * 64
        run["header"]["protocol_digest"] = "0" * 2000

    edit_run(submission, change)
    refused(submission, "header.protocol: it is not minitouch-v1")
    refused(submission, "header.task_digests: they are not of the plan's tasks")
    refused(submission, "a text in it has 2000 characters")


def test_a_policy_that_could_read_the_simulator(submission):
    edit_run(submission, lambda run: run["header"].update(isolation="none"))
    refused(submission, "isolation none")


def test_a_server_that_hides_what_it_is(tmp_path):
    directory = make_submission(tmp_path, "host", kind="remote")
    edit_run(directory, lambda run: run["header"]["policy"].update(notes=[]))
    refused(directory, "remote policy lacks its label")


def test_an_exploration_policy_of_one_training_seed_alone(tmp_path):
    directory = make_submission(tmp_path, seeds=(0, 1, 2), include=False)
    shutil.rmtree(directory / "seed-1")
    write_official(official_run(seed=1, exploration=True), directory / "seed-1/table4")
    refused(directory, "2 of 3 training seeds have no exploration policy: 0, 2")


@pytest.mark.parametrize("exploration", [False, True])
def test_a_training_seed_submitted_twice(tmp_path, exploration):
    """With its exploration the final episodes are the same bits, and the run's digest is not."""
    directory = make_submission(tmp_path, seeds=(0, 1), include=False)
    shutil.rmtree(directory / "seed-1")
    write_official(official_run(seed=0, exploration=exploration), directory / "seed-1/table4")
    refused(directory, "seed-1/table4", "400 of its 400 episodes are bit for bit those of seed-0")


def test_a_training_seed_that_is_nearly_another_one_s_copy(tmp_path):
    """All pairs are compared, not each with the first one alone."""
    directory = make_submission(tmp_path, seeds=(0, 1, 2), include=False)
    shutil.rmtree(directory / "seed-2")
    copied, own = official_run(seed=1), official_run(seed=2)
    mixed = replace(copied, records=(*own.records[:200], *copied.records[200:]))
    write_official(mixed, directory / "seed-2/table4")
    refused(directory, "seed-2/table4", "200 of its 400 episodes are bit for bit those of seed-1")


def test_an_exploration_by_the_scripted_policy(tmp_path):
    directory = make_submission(tmp_path, exploration=True)
    edit_run(
        directory,
        lambda run: run["header"]["exploration"].update(
            kind="scripted", digest="", notes=["reads the simulator's state"]
        ),
    )
    refused(directory, "its exploration is the scripted policy's")


def test_a_trained_policy_cannot_take_a_calibration_s_name(submission):
    moved = submission.rename(submission.parent / "random")
    edit_toml(moved, 'name = "hac"', 'name = "random"')
    refused(moved, "'random' is a built-in policy's")


# Text


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("name", "x" * 10_000, "a name of"),
        ("name", "../../etc", "a name of"),
        ("name", "Hac", "a name of"),
        ("method", "x" * 10_000, "length"),
        ("method", "<img src=x onerror=alert(1)>", "plain text"),
        ("method", "=HYPERLINK(1)", "formula"),
        ("method", "+1", "formula"),
        ("method", "a\\u202Eb", "control"),
        ("method", "a\\u001b[31mb", "plain text"),
        ("method", "a\\nb", "plain text"),
        ("method", "", "length"),
        ("notes", "@SUM(A1)", "formula"),
        ("license", "do what you want!", "SPDX"),
        ("paper", "javascript:alert(1)", "a link"),
        ("paper", "http://example.org", "a link"),
        ("paper", "https://user:pass@example.org/x", "a link"),
        ("paper", "https://example.org/'onclick=x \\\\\\\"", "a link"),
        ("code", "https://" + "x" * 400 + ".org", "length"),
        ("code", "file:///etc/passwd", "a link"),
    ],
)
def test_texts_that_could_be_taken_for_more(submission, key, value, words):
    text = (submission / "submission.toml").read_text()
    (line,) = [line for line in text.splitlines() if line.startswith(f"{key} = ")]
    edit_toml(submission, line, f'{key} = "{value}"')
    refused(submission, "submission.toml", key, words)


def test_an_author_with_a_script(submission):
    edit_toml(submission, '"A. Researcher"', '"<script>alert(1)</script>"')
    refused(submission, "authors", "plain text")


def test_endless_texts_in_a_run(submission):
    edit_run(submission, lambda run: run["header"]["policy"].update(name="x" * 10_000))
    refused(submission, RUN, "10000 characters")


def test_endless_lists_of_packages(submission):
    packages = {f"package-{number}": "1" for number in range(10_000)}
    edit_run(submission, lambda run: run["environment"].update(packages=packages))
    refused(submission, RUN, "its environment names 10000 things")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("version = 1", "version = 2", "version is not 1"),
        ("version = 1", "version = 0x" + 4000 * "f", "version is not 1"),
        ('format = "minitouch-submission"', 'format = "x"', "its format is not"),
        ("training_steps = 2000000", "training_steps = -1", "training_steps"),
        ("training_steps = 2000000", "training_steps = nan", "training_steps"),
        ("training_steps = 2000000", "training_steps = 99999999999999", "training_steps"),
        ('"vision",\n    "touch"', '"state"', "only scripted"),
        ('"vision",\n    "touch"', '"smell"', "modalities"),
        ("seed = 0", "seed = -3", "seed"),
        ('name = "hac"', 'nme = "hac"', "no key 'nme'"),
        ('name = "hac"', 'nme = "hac"', "'name' is missing"),
        ('name = "hac"', "name = 1979-05-27", "expected str"),
        ("[[seeds]]", "[[seeds", "is not TOML"),
        ('sha256 = "', 'sha256 = "zz', "sha256"),
    ],
)
def test_other_mistakes_in_the_file(submission, old, new, words):
    edit_toml(submission, old, new)
    refused(submission, "submission.toml", words)


# Paths and files


@pytest.mark.parametrize("path", ["../../other/table4", "/etc", "seed-0/../../x", "seed-1/table4"])
def test_paths_of_runs_that_lead_elsewhere(submission, path):
    edit_toml(submission, 'table4 = "seed-0/table4"', f'table4 = "{path}"')
    refused(submission, path, "outside its place")


@pytest.mark.parametrize("path", ["../../secret", "/etc/passwd", "checkpoints/other"])
def test_paths_of_checkpoints_that_lead_elsewhere(submission, path):
    edit_toml(submission, 'path = "checkpoints/seed-0/final/hac.safetensors"', f'path = "{path}"')
    refused(submission, path, "outside its place")


@pytest.mark.parametrize("name", ["../x.onnx", "a/b.onnx", ".hidden.onnx", "x.exe"])
def test_file_names_that_are_none(submission, name):
    edit_toml(submission, 'file = "hac.safetensors"', f'file = "{name}"')
    refused(submission, "file")


@pytest.mark.parametrize("place", [f"{RUN}/run.json", RUN, "submission.toml", "checkpoints"])
def test_symbolic_links(submission, tmp_path, place):
    target = tmp_path / "elsewhere"
    (submission / place).rename(target)
    (submission / place).symlink_to(target)
    refused(submission, place, "symbolic link")


def test_a_submission_that_is_a_link(submission):
    link = submission.parent / "link"
    link.symlink_to(submission)
    refused(link, "it is a link")


def test_a_named_pipe_is_never_opened(submission):
    os.mkfifo(submission / RUN / "pipe")
    refused(submission, f"{RUN}/pipe", "no plain file")


def test_unknown_files(submission):
    (submission / RUN / "conftest.py").write_text("raise SystemExit")
    (submission / "checkpoints/seed-0/final/other.safetensors").write_bytes(b"x")
    refused(submission, f"{RUN}/conftest.py", "no such file")
    refused(submission, "other.safetensors", "no such file")


def test_files_that_are_too_large(submission):
    with (submission / RUN / "actions.npz").open("r+b") as file:
        file.truncate(100 * 2**20)
    refused(submission, f"{RUN}/actions.npz", "the limit is")


def test_deep_directories(submission):
    (submission / "a/b/c/d/e/f").mkdir(parents=True)
    refused(submission, "levels deep")


def test_a_zip_bomb_as_a_checkpoint(submission):
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("data.pkl", bytes(300_000_000))
    for role in ("final", "exploration"):
        place = submission / f"checkpoints/seed-0/{role}/hac.safetensors"
        place.rename(place.with_suffix(".pt"))
        place.with_suffix(".pt").write_bytes(bomb.getvalue())
    file = submission / "submission.toml"
    file.write_text(file.read_text().replace("hac.safetensors", "hac.pt"))
    refused(submission, "hac.pt", "declares 300000000: it is not unpacked")
    refused(submission, "hac.pt", "SHA-256 is not that of submission.toml")


def test_a_checkpoint_that_runs_code_when_read_is_never_read(submission):
    class Boom:
        def __reduce__(self):
            return os.mkdir, ("executed",)

    (submission / "checkpoints/seed-0/final/hac.safetensors").write_bytes(pickle.dumps(Boom()))
    refused(submission, "final/hac.safetensors", "SHA-256")
    assert not Path("executed").exists()


def test_a_checkpoint_that_was_replaced_after_its_proof(submission):
    """A leaderboard trusts what was proved of the runs, and looks at the checkpoints again."""
    (submission / "checkpoints/seed-0/final/hac.safetensors").write_bytes(b"another policy")
    (problem,) = validate(submission, trust_proofs=True).problems
    assert "SHA-256 is not that of submission.toml" in str(problem)


@pytest.mark.parametrize("field", ["clipped_actions", "ticks", "touch_onsets", "first_touch_tick"])
def test_a_count_that_no_computer_can_hold(submission, field):
    edit_run(submission, lambda run: run["episodes"][0].update({field: 10**400}))
    refused(submission, RUN, f"episodes[0].{field}: expected int <= 9223372036854775807")


def test_a_checkpoint_that_was_not_evaluated(submission):
    edit_run(submission, lambda run: run["header"]["policy"].update(digest="0" * 64))
    refused(submission, RUN, "is not the checkpoints of submission.toml")


# JSON


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity"])
def test_numbers_that_json_does_not_have(submission, number):
    file = submission / RUN / "run.json"
    text = file.read_text()
    file.write_text(text.replace('"touch_variance": ', f'"touch_variance": {number}, "x": ', 1))
    refused(submission, f"{RUN}/run.json", "is not JSON")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "not JSON"),
        ("[" * 100_000, "expected object"),
        ('{"format": 1, "format": 2}', "expected str"),
        ("1" * 10_000, "out of range"),
        ('{"format": "minitouch-run", "version": 9}', "version 9"),
        ("null", "expected object"),
    ],
)
def test_json_that_is_no_run(submission, content, words):
    (submission / RUN / "run.json").write_text(content)
    refused(submission, f"{RUN}/run.json", words)


def test_a_key_that_is_there_twice(submission):
    file = submission / RUN / "run.json"
    text = file.read_text()
    file.write_text(text.replace('"official": true,', '"official": false,\n  "official": true,', 1))
    refused(submission, f"{RUN}, run.json", "there twice")


def test_an_infinite_number_written_as_a_large_one(submission):
    file = submission / RUN / "run.json"
    text = file.read_text()
    file.write_text(text.replace('"wall_s": 754.2', '"wall_s": 1e999'))
    refused(submission, f"{RUN}/run.json", "wall_s", "out of range")


# What is no submission


def test_what_is_no_submission(tmp_path):
    refused(tmp_path / "none", "it is not a directory")
    refused(tmp_path, "this is no submission")
