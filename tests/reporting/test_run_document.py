import copy
import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import msgspec
import pytest

from benchmarks.schemas import run_schema
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.runs.run import parse_run, run_json
from tests.reporting.synthetic import make_run, measured

PUBLISHED = Path(__file__).parents[2] / "docs" / "run.schema.json"
VALIDATOR = jsonschema.Draft202012Validator(run_schema())


def content_of(run) -> bytes:
    return run_json(measured(run))


def read(document):
    return parse_run(json.dumps(document).encode(), "x")


@pytest.fixture(scope="module")
def document():
    return json.loads(content_of(make_run(episodes=6, faults=2)))


def test_the_published_schema_is_that_of_the_types():
    assert json.loads(PUBLISHED.read_text("utf-8")) == run_schema(), "run `make schemas`"
    jsonschema.Draft202012Validator.check_schema(run_schema())


@pytest.mark.parametrize(
    "run",
    [
        make_run(episodes=5, faults=1),
        make_run(tasks=("playing",), episodes=2, exploration=False, official=False),
        replace(make_run(tasks=("pushing",), episodes=1), records=()),
    ],
)
def test_documents_follow_the_schema_and_read_back(run):
    done = measured(run, "x")
    content = run_json(done)
    VALIDATOR.validate(json.loads(content))
    again = parse_run(content, "x")
    assert again == replace(done, content=content)
    assert run_json(again) == content
    assert again.faults == {r.spec.key: r.fault for r in run.records if r.fault}


def test_times_stand_under_environment_only():
    run = make_run(episodes=3)
    later = replace(run.environment, started="2030-01-01T00:00:00Z", wall_s=1.0)
    first, second = (json.loads(content_of(one)) for one in (run, replace(run, environment=later)))
    assert first.pop("environment") != second.pop("environment")
    assert first == second


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_nan_and_infinity_are_never_written(hac, number):
    broken = replace(hac, environment=replace(hac.environment, wall_s=number))
    with pytest.raises(ValueError, match=r"environment\.wall_s"):
        run_json(broken)


MISTAKES = [
    (("format",), "other", "its format is not 'minitouch-run'"),
    (("version",), 1, "run.json has version 1"),
    (("header", "plan", "seed"), "7", "run.json.header.plan.seed: expected int, got str"),
    (("header", "official"), 1, "run.json.header.official: expected bool"),
    (("header", "plan", "tasks"), "pushing", "run.json.header.plan.tasks: expected array"),
    (("header", "plan", "tasks"), ["juggling"], "run.json: this version has no task 'juggling'"),
    (("header", "plan", "limits", "act_timeout_s"), -1.0, "run.json.header.plan.limits"),
    (("header", "plan", "conditions", "without"), ["smell"], "run.json.header.plan.conditions"),
    (("header", "policy"), None, "run.json.header.policy: expected object"),
    (("environment", "packages"), {"numpy": 2}, "run.json.environment.packages[...]: expected"),
    (("episodes", 0, "outcome"), "won", "run.json.episodes[0].outcome: invalid enum value 'won'"),
    (("episodes", 0, "steps"), -1, "run.json.episodes[0].steps: expected int >= 0"),
    (("episodes", 0, "episode_return"), True, "episode_return: expected float, got bool"),
    (("summary", "tasks", 1, "estimates", "success", "low"), "0", ".low: expected float, got str"),
    (("faults",), [], "run.json.faults: expected object"),
]


def edited(document, place, value):
    broken = copy.deepcopy(document)
    target = broken
    for key in place[:-1]:
        target = target[key]
    target[place[-1]] = value
    return broken


LIMITS = ("header", "plan", "limits")
TOO_MUCH = [
    ((*LIMITS, "act_timeout_s"), 1e300, "run.json: a time limit is above 0 and at most 86400 s"),
    ((*LIMITS, "memory_mb"), 2**60, "run.json: a memory limit is 1 to 16777216 MiB"),
]


@pytest.mark.parametrize(("place", "value", "message"), [*MISTAKES, *TOO_MUCH])
def test_a_malformed_document_gives_one_clear_line(document, place, value, message):
    with pytest.raises(RunDirectoryError) as raised:
        read(edited(document, place, value))
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(("place", "value", "message"), MISTAKES)
def test_the_schema_refuses_the_same_mistakes(document, place, value, message):
    assert not VALIDATOR.is_valid(edited(document, place, value))


@pytest.mark.parametrize("key", ["header", "environment", "summary", "faults", "episodes"])
def test_a_missing_part_is_named(document, key):
    broken = {name: value for name, value in document.items() if name != key}
    with pytest.raises(RunDirectoryError, match=f"missing required field {key}"):
        read(broken)
    assert not VALIDATOR.is_valid(broken)


@pytest.mark.parametrize("value", [None, 3, [], "text"])
def test_what_is_no_object_is_refused(value):
    with pytest.raises(RunDirectoryError, match="expected object"):
        read(value)


@pytest.mark.parametrize("content", [b"", b"{", b'{"format": NaN}', b"\xff", b"[" * 10**6])
def test_what_is_no_json_is_refused_in_one_line(content):
    with pytest.raises(RunDirectoryError) as raised:
        parse_run(content, "x")
    assert "\n" not in str(raised.value)


def test_a_stranger_s_text_reaches_no_terminal_and_stays_short(document):
    broken = edited(document, ("episodes", 0, "outcome"), "\x1b[2J\n\u202e" + "x" * 10_000)
    with pytest.raises(RunDirectoryError) as raised:
        read(broken)
    assert str(raised.value).isprintable()
    assert len(str(raised.value)) < 300


def test_a_key_that_the_types_do_not_know_is_passed_over_and_not_written(document):
    run = read(edited(document, ("header", "sponsor"), "somebody"))
    assert run_json(run) == msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n"
