import copy
import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.metrics.summary import measure_run, summarize
from minitouch_bench.records import Role
from minitouch_bench.reporting.json_document import from_document, to_document, to_text
from tests.reporting.synthetic import make_run

SCHEMA = json.loads((Path(__file__).parents[2] / "docs" / "run.schema.json").read_text("utf-8"))
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def document_of(run):
    return to_document(run, summarize(run, np.random.default_rng(0)))


@pytest.fixture(scope="module")
def document():
    return document_of(make_run(episodes=6, faults=2))


def test_the_schema_is_valid():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


@pytest.mark.parametrize(
    "run",
    [
        make_run(episodes=5, faults=1),
        make_run(tasks=("playing",), episodes=2, exploration=False, official=False),
        replace(make_run(tasks=("pushing",), episodes=1), records=()),
    ],
)
def test_documents_follow_the_schema_and_read_back(run):
    summary = summarize(run, np.random.default_rng(0))
    document = json.loads(to_text(to_document(run, summary)))
    VALIDATOR.validate(document)
    saved = from_document(document, "x")
    assert saved.header == run.header
    assert saved.environment == run.environment
    assert saved.summary == summary
    assert saved.episodes == measure_run(run)
    assert saved.exploration_episodes == measure_run(run, Role.EXPLORATION)
    assert saved.faults == {r.spec.key: r.fault for r in run.records if r.fault}


def test_times_stand_under_environment_only():
    run = make_run(episodes=3)
    later = replace(run.environment, started="2030-01-01T00:00:00Z", wall_s=1.0)
    first, second = document_of(run), document_of(replace(run, environment=later))
    assert first.pop("environment") != second.pop("environment")
    assert to_text(first) == to_text(second)


def test_nan_is_never_written(document):
    broken = copy.deepcopy(document)
    broken["episodes"][0]["return"] = float("nan")
    with pytest.raises(ValueError, match="JSON compliant"):
        to_text(broken)


MISTAKES = [
    (("format",), "other", "its format is not 'minitouch-run'"),
    (("version",), 2, "run.json has version 2"),
    (("header", "seed"), "7", "run.json.header.seed should be a whole number, not '7'"),
    (("header", "official"), 1, "run.json.header.official should be true or false"),
    (("header", "tasks"), "pushing", "run.json.header.tasks should be a list"),
    (("header", "tasks"), ["juggling"], "should be one of playing, pushing"),
    (("header", "policy"), None, "run.json.header.policy should be an object"),
    (("environment", "packages"), {"numpy": 2}, "run.json.environment.packages.numpy"),
    (("episodes", 0, "outcome"), "won", "run.json.episodes[0].outcome should be one of success"),
    (("episodes", 0, "steps"), -1, "run.json.episodes[0].steps should be 0 or more"),
    (("episodes", 0, "return"), float("inf"), "should be a finite number"),
    (("episodes", 0, "return"), True, "should be a number"),
    (("summary", "tasks", 1, "estimates", "success", "low"), "0", "should be a number"),
    (("summary", "tasks", 1, "estimates", "success", "method"), "t", "one of wilson"),
    (("faults",), [], "run.json.faults should be an object"),
]


@pytest.mark.parametrize(("place", "value", "message"), MISTAKES)
def test_a_malformed_document_gives_one_clear_line(document, place, value, message):
    broken = copy.deepcopy(document)
    target = broken
    for key in place[:-1]:
        target = target[key]
    target[place[-1]] = value
    with pytest.raises(RunDirectoryError) as raised:
        from_document(broken, "x")
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


def test_the_schema_refuses_the_same_mistakes(document):
    for place, value, _ in MISTAKES:
        if value == float("inf"):  # no JSON file can hold it
            continue
        broken = copy.deepcopy(document)
        target = broken
        for key in place[:-1]:
            target = target[key]
        target[place[-1]] = value
        assert not VALIDATOR.is_valid(broken), place


@pytest.mark.parametrize("key", ["header", "environment", "summary", "faults", "episodes"])
def test_a_missing_part_is_named(document, key):
    broken = {name: value for name, value in document.items() if name != key}
    with pytest.raises(RunDirectoryError, match=f"'{key}' is missing"):
        from_document(broken, "x")


@pytest.mark.parametrize("value", [None, 3, [], "text"])
def test_what_is_no_object_is_refused(value):
    with pytest.raises(RunDirectoryError, match="should be an object"):
        from_document(value, "x")
