"""``submission.toml``: written, read back, and as its published schema describes it."""

import json
import tomllib
from dataclasses import replace

import jsonschema
import pytest
import tomli_w

from benchmarks.schemas import board_schema, submission_schema
from minitouch_bench.episode import Role
from minitouch_bench.errors import UsageError
from minitouch_bench.json_io import write_toml
from minitouch_bench.leaderboard.submission import (
    CheckpointFile,
    Submission,
    TrainingSeed,
    read_submission,
)
from minitouch_bench.verification.static_check import Problems
from tests.altered import DOCS, ROOT
from tests.leaderboard.synthetic import ABOUT

STORED = sorted(path.parent for path in ROOT.glob("submissions/*/submission.toml"))
SEEDS = (
    TrainingSeed(
        0,
        {"table4": "seed-0/table4", "novel-shapes": "seed-0/novel-shapes"},
        (
            CheckpointFile(
                Role.FINAL, "all", "hac.onnx", "ab" * 32, "checkpoints/seed-0/final/hac.onnx"
            ),
            CheckpointFile(Role.EXPLORATION, "pushing", "pushing.pt", "cd" * 32),
        ),
    ),
    TrainingSeed(3, {"table4": "seed-3/table4"}),
)


@pytest.mark.parametrize(
    ("name", "schema_of"), [("submission", submission_schema), ("leaderboard", board_schema)]
)
def test_the_published_schemas_are_those_of_the_types(name, schema_of):
    published = json.loads((DOCS / f"{name}.schema.json").read_text("utf-8"))
    assert published == schema_of(), "run `make schemas`"


def schema(name: str) -> jsonschema.Draft202012Validator:
    document = json.loads((DOCS / name).read_text())
    jsonschema.Draft202012Validator.check_schema(document)
    return jsonschema.Draft202012Validator(document)


def read(text: str) -> tuple[Submission, list[str]]:
    problems = Problems()
    return read_submission(text.encode(), problems), [str(problem) for problem in problems]


@pytest.mark.parametrize(
    "about",
    [
        ABOUT,
        replace(
            ABOUT, method='A "quoted" \\ method; ü, 触', notes="", authors=(), paper="", code=""
        ),
        replace(ABOUT, training_steps=0, modalities=("touch",), license=""),
    ],
)
def test_what_is_written_is_read_back(about):
    submission = replace(about, seeds=SEEDS)
    assert read(write_toml(submission)) == (submission, [])


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("name", name) for name in ("../x", "x" * 65, "hac\n", "hac.html", "a..b", "Hac")),
        *(("paper", link) for link in ("http://example.org", "https://example.org/x\n")),
        ("paper", "https://user:pass@example.org/x"),
        *(("code", link) for link in ("https://localhost", "https://a.org/" + "x" * 300)),
        *(("license", text) for text in ("do what you want!", "MIT\n")),
        ("training_steps", -1),
        *(("modalities", given) for given in (["smell"], ["touch", "touch"])),
        ("seeds", []),
        ("extra", 1),
        *(("method", text) for text in ("", "<b>", "two\nlines", "a line\n", "two  spaces", " a")),
        *(("authors", [text]) for text in ("=SUM(A1)", "@SUM(A1)", "+1")),
        ("notes", "x" * 2001),
        *(("file", name) for name in ("a:b.onnx", "a.onnx.", "a.onnx\n", "../a", ".a")),
        ("sha256", "ab" * 32 + "\n"),
        ("task", "all\n"),
    ],
)
def test_the_schema_refuses_what_the_reader_refuses(key, value):
    document = tomllib.loads(write_toml(replace(ABOUT, seeds=SEEDS)))
    checkpoint = document["seeds"][0]["checkpoints"][0]
    (checkpoint if key in ("file", "sha256", "task") else document)[key] = value
    assert not schema("submission.schema.json").is_valid(document)
    assert any(key in problem for problem in read(tomli_w.dumps(document))[1])


@pytest.mark.parametrize("name", ["nul", "x.y", "a-1"])
def test_names_that_are_let_in(name):
    file = replace(SEEDS[0].checkpoints[1], file=f"{name}.ONNX")
    submission = replace(ABOUT, name=name, seeds=(replace(SEEDS[0], checkpoints=(file,)),))
    assert read(write_toml(submission)) == (submission, [])


@pytest.mark.parametrize("text", ["a\u202eb", "a\u200bb", "e\u0301", "a\u2028b"])
def test_characters_that_no_pattern_names(text):
    (problem,) = read(write_toml(replace(ABOUT, method=text, seeds=SEEDS)))[1]
    assert "method" in problem


@pytest.mark.parametrize("directory", STORED, ids=lambda path: path.name)
def test_every_stored_submission_is_read_whole(directory):
    submission, problems = read((directory / "submission.toml").read_text())
    assert problems == []
    assert submission.name == directory.name
    tables = tomllib.loads((directory / "submission.toml").read_text())
    assert tomllib.loads(write_toml(submission)) == tables


def test_a_key_of_many_parts_is_not_parsed():
    content = b'format = "minitouch-submission"\nversion = 1\n' + b"a." * 32_000 + b"a = 1\n"
    with pytest.raises(UsageError, match="dots"):
        read_submission(content, Problems())
