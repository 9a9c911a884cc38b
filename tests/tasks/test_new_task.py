"""Proof by doing: a task is its facts, its rules and its line in the table, and a controller.

The files in ``tests/tasks/peg`` are put into a copy of the package, which then evaluates the
fifth task, reports it, packs it as a submission and ranks it on the board.
"""

import json
import shutil
from pathlib import Path

import pytest

from tests.altered import copy_package, edit, python

PEG = Path(__file__).parent / "peg"


def add_the_task(package: Path) -> None:
    """Write the fifth task: its facts, its rules and its controller, each with its line."""
    table = "\nTASK_SPECS: tuple[TaskSpec, ...] = (PLAYING, PUSHING, OPENING, PICK_UP)\n"
    suite = '"table4", ("playing", "pushing", "opening", "pick-up"), 100, rankable=True'
    edit(
        package / "protocol" / "tasks.py",
        (table, (PEG / "facts.py").read_text()),
        (suite, '"table4", ("playing", "pushing", "opening", "pick-up", "peg"), 2, rankable=True'),
    )
    shutil.copy(PEG / "task.py", package / "tasks" / "peg.py")
    edit(
        package / "tasks" / "registry.py",
        (
            "from minitouch_bench.tasks.pick_up",
            "from minitouch_bench.tasks.peg import Peg\nfrom minitouch_bench.tasks.pick_up",
        ),
        ("(Playing, Pushing, Opening, PickUp)", "(Playing, Pushing, Opening, PickUp, Peg)"),
    )
    table, controller = "CONTROLLERS: dict[str, type[Controller]] = {", PEG / "controller.py"
    edit(
        package / "policies" / "scripted.py",
        (table, f'{controller.read_text()}\n\n{table}\n    "peg": PegController,'),
    )


TAKE_PICTURE = """
import sys
from PIL import Image
import minitouch_bench as mt
environment = mt.make("peg", render_mode="rgb_array")
environment.reset(seed=0)
Image.fromarray(environment.render()).save(sys.argv[1])
"""


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    """The command line of a package with five tasks, in a directory of its own."""
    root = tmp_path_factory.mktemp("task")
    package = copy_package(root)
    add_the_task(package)

    def run(*arguments: str) -> str:
        return python(package, root, "-m", "minitouch_bench", *arguments)

    picture = package / "reporting" / "pictures" / "peg.png"
    python(package, root, "-c", TAKE_PICTURE, str(picture))
    run.root = root
    return run


@pytest.fixture(scope="module")
def submission(command) -> Path:
    command("evaluate", "scripted", "--workers", "1")
    about = ("--name", "scripted", "--training-steps", "0")
    command("submit", "reports/scripted-table4", *about)
    return command.root / "submissions" / "scripted"


def test_it_is_listed(command):
    assert "MiniTouch/Peg-v1" in command("tasks")
    assert "peg on the plate" in command("tasks")


def test_its_episodes_are_evaluated(command, submission):
    run = json.loads((submission / "seed-0" / "table4" / "run.json").read_text())
    outcomes = [one["outcome"] for one in run["episodes"] if one["task"] == "peg"]
    assert outcomes == ["success", "success"]
    command("verify", str(submission / "seed-0" / "table4"))


def test_open_loop_has_no_sequence_for_it_and_holds_still(command):
    command("evaluate", "open-loop", "--tasks", "peg", "--episodes", "1", "--output", "still")
    (episode,) = json.loads((command.root / "still" / "run.json").read_text())["episodes"]
    assert episode["outcome"] == "step_limit"


def test_it_is_in_the_report(command, submission):
    command("report", str(submission / "seed-0" / "table4"), "--output", "report")
    text = (command.root / "report" / "report.html").read_text()
    assert "Peg" in text


def test_it_is_on_the_board(command, submission):
    command("leaderboard", "validate", str(submission))
    command("leaderboard", "build")
    (board,) = command.root.rglob("leaderboard.json")
    (row,) = json.loads(board.read_text())["calibration"]
    assert row["figures"]["peg"]["success"]["value"] == 1.0
    assert "Peg" in (board.parent / "index.html").read_text()
