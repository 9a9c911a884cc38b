"""``submission.toml`` and the files beside it: written, read back, and what is refused."""

import json
import os
import tomllib
from dataclasses import replace

import jsonschema
import pytest
import tomli_w

import minitouch_bench as mt
from benchmarks.schemas import board_schema, run_schema, submission_schema
from minitouch_bench.episode import Role
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.execution import package_versions
from minitouch_bench.files import PACKED_RUN_FILE
from minitouch_bench.json_io import write_toml
from minitouch_bench.leaderboard.submission import check_submission, mistakes, read_submission
from minitouch_bench.machine import machine_facts
from minitouch_bench.policies.sources import CheckpointFile, SubmittedTraining
from minitouch_bench.runs.run import read_run
from tests.altered import DOCS, ROOT
from tests.leaderboard.synthetic import ABOUT, make_submission

STORED = sorted(path.parent for path in ROOT.glob("submissions/*/submission.toml"))
ADDRESS = f"hf://user/repo@{'ab' * 20}/pushing.pt"
TRAININGS = (
    SubmittedTraining(
        0,
        (
            CheckpointFile(Role.FINAL, "all", "hac.onnx", "ab" * 32),
            CheckpointFile(Role.EXPLORATION, "pushing", "pushing.pt", "cd" * 32, ADDRESS),
        ),
    ),
)
WHOLE = replace(ABOUT, trainings=TRAININGS)


@pytest.mark.parametrize(
    ("name", "schema_of"),
    [("submission", submission_schema), ("leaderboard", board_schema), ("run", run_schema)],
)
def test_the_published_schemas_are_those_of_the_types(name, schema_of):
    assert schema(f"{name}.schema.json").schema == schema_of(), "run `make schemas`"


def schema(name: str) -> jsonschema.Draft202012Validator:
    document = json.loads((DOCS / name).read_text())
    jsonschema.Draft202012Validator.check_schema(document)
    return jsonschema.Draft202012Validator(document)


@pytest.fixture
def read(tmp_path):
    def read_text(text):
        (tmp_path / "submission.toml").write_text(text)
        return read_submission(tmp_path)

    return read_text


@pytest.mark.parametrize(
    "about",
    [
        WHOLE,
        replace(WHOLE, method='A "quoted" \\ method; ü, 触', notes="", authors=(), paper=""),
        replace(WHOLE, training_steps=0, modalities=("touch",), license=""),
    ],
)
def test_what_is_written_is_read_back(read, about):
    assert read(write_toml(about)) == about
    assert schema("submission.schema.json").is_valid(tomllib.loads(write_toml(about)))
    assert [*mistakes(about)] == []


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("name", name) for name in ("../x", "x" * 65, "hac\n", "hac.html", "a..b", "Hac")),
        *(("paper", link) for link in ("http://example.org", "https://example.org/x\n")),
        ("paper", "https://user:pass@example.org/x"),
        *(("code", link) for link in ("https://localhost", "https://a.org/" + "x" * 300)),
        *(("license", text) for text in ("do what you want!", "MIT\n")),
        ("training_steps", -1),
        ("modalities", ["smell"]),
        ("suites", ["smoke"]),
        ("suites", []),
        ("trainings", []),
        ("extra", 1),
        *(("method", text) for text in ("", "<b>", "two\nlines", "a line\n", "two  spaces", " a")),
        *(("authors", [text]) for text in ("=SUM(A1)", "@SUM(A1)", "+1")),
        ("notes", "x" * 2001),
        *(("file", name) for name in ("a:b.onnx", "a.onnx.", "a.onnx\n", "../a", ".a")),
        ("sha256", "ab" * 32 + "\n"),
        ("task", "all\n"),
        ("address", "hf://user/repo/file.onnx"),  # without a commit it can change
    ],
)
def test_the_schema_refuses_what_the_reader_refuses(read, key, value):
    document = tomllib.loads(write_toml(WHOLE))
    checkpoint = document["trainings"][0]["checkpoints"][0]
    inner = ("file", "sha256", "task", "address")
    (checkpoint if key in inner else document)[key] = value
    assert not schema("submission.schema.json").is_valid(document)
    with pytest.raises(UsageError, match=key):
        read(tomli_w.dumps(document))


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "not a minitouch-submission"),
        ('format = "minitouch-submission"', "of version 2"),
        ("x" * 70_000, "large"),
        ('format = "minitouch-submission"\nversion = 2\n' + "a." * 32_000 + "a = 1\n", "dots"),
    ],
)
def test_another_file_is_not_a_submission(read, text, word):
    with pytest.raises(UsageError, match=rf"submission\.toml.*{word}"):
        read(text)


FINAL, EXPLORED = TRAININGS[0].checkpoints
OWN = replace(EXPLORED, address="")


def training(*files):
    return {"trainings": (SubmittedTraining(0, files),)}


@pytest.mark.parametrize(
    ("change", "word"),
    [
        *(({"method": text}, "unseen") for text in ("a\u202eb", "a\u200bb", "e\u0301", "a\u2028b")),
        ({"method": "HaC (paper)"}, "paper"),
        ({"learner": ""}, "learner"),
        ({"modalities": ("touch", "touch")}, "modalities"),
        ({"suites": ("table4", "table4")}, "suites"),
        ({"modalities": ()}, "modalities"),
        ({"modalities": ("state",)}, "state"),
        ({"trainings": TRAININGS * 2}, "twice"),
        ({"trainings": (*TRAININGS, replace(TRAININGS[0], seed=1))}, "same final checkpoints"),
        (training(), "no final checkpoint"),
        (training(FINAL, replace(OWN, role=Role.FINAL)), "one file"),
        (training(FINAL, replace(OWN, sha256=FINAL.sha256)), "is the final policy"),
        (training(replace(FINAL, file="hac.bin")), "not a check"),
        (training(replace(FINAL, task="opening")), "its task"),
        (training(replace(FINAL, address=ADDRESS)), "not the name"),
        ({"name": "zero"}, "without checkpoints"),
        ({"name": "scripted", "modalities": (), **training()}, "state"),
        (
            {"trainings": (*TRAININGS, SubmittedTraining(1, (replace(FINAL, sha256="0" * 64),)))},
            "no exploration policy",
        ),
    ],
)
def test_what_no_form_can_say_is_said(change, word):
    found = [*mistakes(replace(WHOLE, **change))]
    assert any(word in problem for problem in found), found


def add(directory, place, content=b""):
    path = directory / place
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


FILE = "checkpoints/seed-0/final/hac.safetensors"


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (lambda at: add(at, "notes.txt"), "notes.txt"),
        (lambda at: add(at, "checkpoints/seed-0/final/other.pt"), "no such file"),
        (lambda at: add(at, FILE, b"other bytes"), "SHA-256"),
        (lambda at: (at / FILE).unlink(), "missing"),
        (lambda at: (at / "link").symlink_to(at / FILE), "link"),
        (lambda at: ((at / FILE).unlink(), (at / FILE).symlink_to("/etc/passwd")), "link"),
        (lambda at: os.mkfifo(at / "pipe"), "pipe"),
        (lambda at: (at / "submission.toml").unlink(), "submission.toml"),
        (lambda at: at.rename(at.with_name("other")), "directory"),
        (lambda at: at.symlink_to(at.rename(at.with_name("other"))), "is a link"),
        (lambda at: make_submission(at.parent, file="hac.bin"), "not a checkpoint"),
    ],
)
def test_a_spoiled_directory_is_refused(submission, spoil, word):
    assert [*check_submission(submission)] == []
    spoil(submission)
    there = submission if submission.exists() else submission.with_name("other")
    found = [*check_submission(there)]
    assert any(word in problem for problem in found), found


def test_a_stored_checkpoint_plays_the_episodes_of_its_row():
    """Rows keep no actions: the checkpoints give them again."""
    place = "hac/seed-30"
    row = read_run(ROOT / "reports" / "results" / place / "table4" / PACKED_RUN_FILE)
    there, here = row.environment, package_versions()
    if machine_facts()["processor"] != there.machine["processor"]:
        pytest.skip("a network has the same bits on one model of processor only")
    if {name: here.get(name) for name in there.packages} != there.packages:
        pytest.skip("the row was played with other packages")
    policy = ROOT / "submissions" / place
    again = mt.evaluate(policy, suite="table4", episodes_from="opening/0")
    assert again.rows[0].digest == row.find("opening/0")[1].digest


@pytest.mark.parametrize("directory", STORED, ids=lambda path: path.name)
def test_every_stored_submission_passes_and_is_written_as_it_is(directory):
    assert [*check_submission(directory)] == []
    text = (directory / "submission.toml").read_text()
    assert tomllib.loads(write_toml(read_submission(directory))) == tomllib.loads(text)
