"""Proof by doing: a metric is an entry in the table and a field of an episode, nothing else.

A fact on the board is one field with its type, nothing else.
"""

import csv
import json
import re
from pathlib import Path

import jsonschema
import pytest

from tests.altered import copy_package, edit, python

ENTRY = """    Metric(
        name="peak_finger_force",
        label="Peak finger force",
        column="peak_finger_force",
        unit="N",
        source="D",
        number_format=".1f",
        meaning="largest force component at a finger",
        measure=lambda record: float(
            np.abs(record.trace.touch[:, FORCE_COMPONENTS]).max(initial=0.0)
        ),
        shown_in=frozenset({ShownIn.DIAGNOSTICS, ShownIn.BOARD}),
    ),
)
# fmt: on
"""

FACT = """    parameters: Annotated[
        int, Meta(ge=0), ColumnSpec("Parameters", "column", "weights", amount, is_text=False)
    ] = 0
"""

NOTES = "    notes: Annotated["

SCRIPT = """
import json, sys
from dataclasses import replace
from pathlib import Path
from benchmarks.schemas import board_schema, run_schema
from minitouch_bench.leaderboard.build import build_board
from minitouch_bench.reporting.writers import write_views
from minitouch_bench.runs.run import read_run
from tests.leaderboard.synthetic import ABOUT, make_submission, official_run, write_official

root = Path(sys.argv[1])
about = replace(ABOUT, parameters=1_234_567)
make_submission(root / "submissions", "random", 0.2, kind="random", about=about)
build_board(root / "submissions", root / "board")
write_official(official_run(kind="random"), root / "run")
run = read_run(root / "run")
write_views(run, root / "run")
(root / "run.schema.json").write_text(json.dumps(run_schema()))
(root / "leaderboard.schema.json").write_text(json.dumps(board_schema()))
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """The files that a package with one metric more writes of a run and of a board."""
    root = tmp_path_factory.mktemp("metric")
    copy = copy_package(root)
    edit(copy / "metrics" / "definitions.py", (")\n# fmt: on\n", ENTRY))
    edit(copy / "leaderboard" / "submission.py", (NOTES, f"{FACT}{NOTES}"))
    field = "    clipped_actions: Count\n"
    edit(copy / "records.py", (field, f"    peak_finger_force: float\n{field}"))
    python(copy, copy.parent, "-c", SCRIPT, str(root))
    return root


@pytest.fixture(scope="module")
def run(built) -> Path:
    return built / "run"


def test_it_is_a_column_of_the_episodes(run):
    with (run / "episodes.csv").open() as file:
        forces = [float(row["peak_finger_force"]) for row in csv.DictReader(file)]
    assert len(forces) == 400
    assert min(forces) > 0


def test_it_is_in_the_run_s_document_and_its_schema(built, run):
    document = json.loads((run / "run.json").read_text())
    schema = json.loads((built / "run.schema.json").read_text())
    jsonschema.Draft202012Validator(schema).validate(document)
    episode = schema["$defs"]["EpisodeMetrics"]["properties"]["peak_finger_force"]
    assert episode == {"type": "number", "description": "Largest force component at a finger; N."}
    for task in document["summary"]["tasks"]:
        own = [e["peak_finger_force"] for e in document["episodes"] if e["task"] == task["task"]]
        estimate = task["estimates"]["peak_finger_force"]
        assert estimate["value"] == pytest.approx(sum(own) / len(own))
        assert estimate["low"] < estimate["value"] < estimate["high"]


def test_it_is_in_the_diagnostics(run):
    report = (run / "report.html").read_text()
    assert "Peak finger force" in report.partition(">Diagnostics<")[2]


def test_it_is_on_the_board(built):
    board = built / "board"
    document = json.loads((board / "leaderboard.json").read_text())
    schema = json.loads((built / "leaderboard.schema.json").read_text())
    jsonschema.Draft202012Validator(schema).validate(document)
    (random,) = document["calibration"]
    for task in ("playing", "pushing", "opening", "pick-up"):
        assert random["figures"][task]["peak_finger_force"]["value"] > 0
    for name in ("leaderboard.md", "index.html", "leaderboard.csv"):
        text = (board / name).read_text()
        assert "Peak finger force" in text or "peak_finger_force" in text


def test_a_fact_is_on_the_board(built):
    board = built / "board"
    document = json.loads((board / "leaderboard.json").read_text())
    assert document["calibration"][0]["parameters"] == 1_234_567
    rows = list(csv.DictReader((board / "leaderboard.csv").read_text().splitlines()))
    assert {row["parameters"] for row in rows if row["name"] == "random"} == {"1234567"}
    for name in ("leaderboard.md", "index.html", "submission/random.html"):
        text = (board / name).read_text()
        assert "Parameters" in text
        assert re.search(r"1\.23\sM", text)
