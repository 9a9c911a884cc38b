"""``run.json``: read back as written, by its published schema, and refused in one line."""

import copy
import gzip
import json
from dataclasses import replace

import jsonschema
import msgspec
import pytest

from benchmarks.schemas import run_schema
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import LARGEST_FILE, PACKED_RUN_FILE
from minitouch_bench.runs.run import parse_run, read_run, run_json
from tests.reporting.synthetic import SHAPE_TASKS, make_run, measured, with_shapes, write

VALIDATOR = jsonschema.Draft202012Validator(run_schema())
NOVEL = with_shapes(make_run(tasks=SHAPE_TASKS, episodes=24, exploration=False))


@pytest.fixture(scope="module")
def document():
    return json.loads(run_json(measured(make_run(episodes=6, faults=2))))


def read(document):
    return parse_run(json.dumps(document).encode(), "x")


def edited(document, place, value):
    broken = copy.deepcopy(document)
    target = broken
    for key in place[:-1]:
        target = target[key]
    target[place[-1]] = value
    return broken


@pytest.mark.parametrize(
    "run",
    [
        make_run(episodes=5, faults=1),
        make_run(tasks=("playing",), episodes=2, exploration=False, official=False),
        replace(make_run(tasks=("pushing",), episodes=1), records=()),
        NOVEL,
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
    assert bool(again.summary.generalization) == (run is NOVEL)


def test_a_run_reads_back_from_its_directory_or_its_file(tmp_path):
    run = write(make_run(episodes=4, faults=1), tmp_path / "a")
    assert "policy faults: 1, the first in pushing/0: act() gave NaN" in str(run)
    assert (run.name, run.directory) == ("a", tmp_path / "a")
    assert run.content == (tmp_path / "a" / "run.json").read_bytes() == run_json(run)
    assert read_run(tmp_path / "a" / "run.json") == run


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_nan_and_infinity_are_never_written(number):
    run = measured(make_run(tasks=("playing",), episodes=1))
    broken = replace(run, environment=replace(run.environment, wall_s=number))
    with pytest.raises(ValueError, match=r"environment\.wall_s"):
        run_json(broken)


PLAN = ("header", "plan")


@pytest.mark.parametrize(
    ("place", "value", "word"),
    [
        (("format",), "other", "minitouch-run"),
        (("version",), 1, "version 1"),
        ((*PLAN, "seed"), "7", "header.plan.seed"),
        ((*PLAN, "tasks"), ["juggling"], "juggling"),
        ((*PLAN, "limits", "act_timeout_s"), -1.0, "header.plan.limits"),
        ((*PLAN, "limits", "act_timeout_s"), 1e300, "86400 s"),
        ((*PLAN, "conditions", "without"), ["smell"], "header.plan.conditions"),
        (("episodes", 0, "outcome"), "won", "'won'"),
        (("summary", "tasks", 1, "estimates", "success", "low"), "0", ".low"),
    ],
)
def test_a_malformed_document_gives_one_clear_line(document, place, value, word):
    broken = edited(document, place, value)
    with pytest.raises(RunDirectoryError) as raised:
        read(broken)
    assert word in str(raised.value)
    assert "\n" not in str(raised.value)
    assert VALIDATOR.is_valid(broken) == (value == 1e300)  # the schema has no greatest time


def test_a_metric_of_a_later_version_is_refused(document):
    estimate = document["summary"]["tasks"][0]["estimates"]["touch_share"]
    broken = edited(document, ("summary", "tasks", 0, "estimates", "luck"), estimate)
    with pytest.raises(RunDirectoryError, match="no metric 'luck'"):
        read(broken)


@pytest.mark.parametrize(
    "content", [b'{"format": NaN}', b"\xff", b"[" * 10**6], ids=["nan", "no UTF-8", "deep"]
)
def test_what_is_no_document_is_refused_in_one_line_that_names_it(tmp_path, content):
    (tmp_path / "run.json").write_bytes(content)
    with pytest.raises(RunDirectoryError) as raised:
        read_run(tmp_path)
    assert tmp_path.name in str(raised.value)
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


def test_a_packed_run_is_read_up_to_the_size_of_any_file(tmp_path):
    (tmp_path / PACKED_RUN_FILE).write_bytes(gzip.compress(bytes(LARGEST_FILE + 1)))
    with pytest.raises(RunDirectoryError, match="larger than 64 MiB"):
        read_run(tmp_path)
