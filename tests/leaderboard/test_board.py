"""What stands on a board: the figures against the runs' own, ranks, copies, who is left out."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from minitouch_bench.json_io import plain
from minitouch_bench.leaderboard.board import CALIBRATION_POLICIES, FLOORS, in_order, make_board
from minitouch_bench.leaderboard.proof import MAX_PROOF, ProofLevel, proof_path
from minitouch_bench.leaderboard.ranking import (
    BOARD_METRICS,
    FLOOR_SUCCESS,
    MEAN_SUCCESS,
    OVERALL,
    Rank,
    count_learned,
    score,
)
from minitouch_bench.leaderboard.site import build_board, find_submissions
from minitouch_bench.leaderboard.validation import validate
from minitouch_bench.leaderboard.views import board_markdown, views
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import over_seeds
from minitouch_bench.metrics.summary import GAP_PARTS, TABLE4_METRICS
from minitouch_bench.protocol.minitouch import GOAL_TASKS, TASK_NAMES
from minitouch_bench.reporting.labels import estimate_cell
from minitouch_bench.reporting.pages import Ending
from minitouch_bench.reporting.report import TABLE_FORMATS, build_report
from minitouch_bench.runs.run import read_run, run_json
from tests.leaderboard.synthetic import make_submission
from tests.leaderboard.test_submission import schema

BOTH = ("table4", "novel-shapes")
STORED = Path(__file__).parents[2] / "submissions"
STORED_RUNS = [STORED / run / "table4" for run in ("hac/seed-20", "scripted/seed-0")]


@pytest.fixture(scope="module")
def submissions(tmp_path_factory):
    root = tmp_path_factory.mktemp("board") / "submissions"
    make_submission(root, "hac", 0.9, suites=BOTH, exploration=True, faults=4)
    make_submission(root, "near", 0.83)
    make_submission(root, "seeds", 0.6, seeds=(0, 1, 2), suites=BOTH)
    make_submission(root, "perfect", 1.0, seeds=(3, 4))
    make_submission(root, "scripted", 1.0, kind="scripted")
    return root


@pytest.fixture(scope="module")
def built(submissions, tmp_path_factory):
    output = tmp_path_factory.mktemp("built")
    build_board(submissions, output)
    return output


@pytest.fixture(scope="module")
def findings(submissions):
    return [validate(path, trust_proofs=True) for path in find_submissions(submissions)]


@pytest.fixture(scope="module")
def board(findings):
    return make_board(findings)


@pytest.fixture(scope="module")
def rows(board):
    return {row.name: row for row in board.rows}


def test_every_interval_on_the_board_is_that_of_its_runs(submissions, built):
    """Those of one seed are in its run.json; of several, ``over_seeds`` of those."""
    document = json.loads((built / "leaderboard.json").read_text())
    schema("leaderboard.schema.json").validate(document)
    compared = 0
    for row in (*document["ranked"], *document["calibration"]):
        runs = [read_run(submissions / row["name"] / place) for place in row["runs"]]
        main = [
            {task.task: task.estimates for task in run.summary.tasks}
            for run in runs
            if run.plan.suite == "table4"
        ]
        for task in TASK_NAMES:
            for metric, figure in row["figures"][task].items():
                estimates = [one[task][metric] for one in main]
                possible = METRICS[metric].range_in(task)
                assert figure == plain(over_seeds(estimates, possible))
                assert len(main) > 1 or figure == plain(estimates[0])
                compared += 1
            shown = {name for name in BOARD_METRICS if all(name in one[task] for one in main)}
            assert row["figures"][task].keys() == shown
        for task, gap in row["novel_shapes"].items():
            metric = ranking_metric(task)
            gaps = [
                result.gaps[metric]
                for run in runs
                for result in run.summary.generalization
                if result.task == task
            ]
            for part in GAP_PARTS:
                parts = [getattr(one, part) for one in gaps]
                possible = (-1.0, 1.0) if part == "difference" else (0.0, 1.0)
                assert gap[part] == plain(over_seeds(parts, possible))
                compared += 1
    assert compared > 150


def test_every_interval_on_the_pages_is_that_of_the_board(built, rows):
    shown = (built / "leaderboard.md").read_text().replace("\\", "")
    for row in rows.values():
        page = (built / "submission" / f"{row.name}.html").read_text()
        for task in TASK_NAMES:
            for metric, figure in row.figures[task].items():
                cell = estimate_cell(metric, figure)
                assert f"{cell.text} <small>{cell.small}</small>" in page
                assert f"{cell.text} {cell.small}" in shown


@pytest.mark.parametrize("place", STORED_RUNS, ids=lambda place: "/".join(place.parts[-3:]))
def test_every_interval_of_a_report_is_that_of_its_run_json(place):
    run = read_run(place)
    shown = TABLE_FORMATS["md"](build_report([run])).replace("\\", "")
    for result in run.summary.tasks:
        for metric in TABLE4_METRICS:
            if metric in result.estimates:
                cell = estimate_cell(metric, result.estimates[metric])
                assert f"{cell.text} {cell.small}" in shown


def runs_on_table4(directory):
    return [read_run(place) for place in sorted(directory.glob("seed-*/table4"))]


def test_the_overall_mean_does_not_depend_on_the_numbers_of_the_seeds(submissions):
    """The trainings of one task are independent of those of another."""
    runs = runs_on_table4(submissions / "seeds")
    turned = [
        replace(run, summary=replace(run.summary, tasks=tuple(
            runs[(index + shift) % len(runs)].summary.tasks[shift]
            for shift in range(len(run.summary.tasks))
        )))
        for index, run in enumerate(runs)
    ]  # fmt: skip
    assert turned[0].summary.tasks != runs[0].summary.tasks
    assert score(turned) == score(runs)


def test_a_seed_has_learned_where_it_is_above_the_best_floor(submissions, rows):
    runs = runs_on_table4(submissions / "seeds")
    assert count_learned(runs) == rows["seeds"].learned == dict.fromkeys(GOAL_TASKS, 3)
    floors = [runs_on_table4(STORED / name)[0] for name in FLOORS]
    best = {
        task.task: max(floor.summary.tasks[index].estimates["success"].value for floor in floors)
        for index, task in enumerate(floors[0].summary.tasks)
        if task.task in GOAL_TASKS
    }
    assert best == FLOOR_SUCCESS
    assert sum(count_learned([*floors, runs[0]]).values()) == len(GOAL_TASKS)


def test_the_mean_success_is_over_the_three_tasks_with_a_goal(rows):
    row = rows["hac"]
    parts = [row.estimate(task, "success") for task in GOAL_TASKS]
    found = row.estimate(OVERALL, MEAN_SUCCESS)
    assert found.value == pytest.approx(np.mean([part.value for part in parts]))
    assert found.low > np.mean([part.low for part in parts])  # three errors do not add up
    assert found.count == 300


def test_ranks_are_shared_where_rows_cannot_be_told_apart(board, rows):
    names = [row.name for row in board.ranked]
    assert (names[0], {*names[1:3]}, names[3]) == ("perfect", {"hac", "near"}, "seeds")
    assert rows["hac"].ranks[OVERALL] == rows["near"].ranks[OVERALL]
    assert rows["seeds"].ranks[OVERALL].best == 4
    assert set(rows["hac"].ranks) == {OVERALL, *TASK_NAMES}


def test_calibrations_have_no_rank(board, rows):
    unsure = {**rows["seeds"].ranks, OVERALL: Rank(1, 4)}  # the order is that of the values
    moved = [replace(row, ranks=unsure) if row.name == "seeds" else row for row in board.ranked]
    assert [row.name for row in in_order(moved, OVERALL)][-1] == "seeds"
    assert [row.name for row in board.calibration] == ["scripted"]
    assert rows["scripted"].ranks == {}
    assert board.missing_calibration == CALIBRATION_POLICIES[1:]


def test_every_episode_has_one_ending(findings, rows):
    counts = rows["hac"].endings
    assert all(sum(own.values()) == 100 for own in counts.values())
    assert counts["pushing"][Ending.FAULT] == 4
    (hac,) = [found for found in findings if found.submission.name == "hac"]
    won = sum(episode.success for episode in hac.episodes("pushing")[0])
    assert counts["pushing"][Ending.SUCCEEDED] == won
    assert sum(rows["seeds"].endings["opening"].values()) == 300
    assert set(counts["playing"]) <= {Ending.TOUCHED, Ending.NEVER_TOUCHED}


@pytest.fixture
def copied(submissions, tmp_path):
    """The submission ``near`` without its proof, and its episodes under another name."""
    root = tmp_path / "submissions"
    shutil.copytree(submissions / "near", root / "near")
    copied = make_submission(root, "copied", 0.5, level=ProofLevel.SELF_REPORTED)
    shutil.rmtree(copied / "seed-0")
    shutil.copytree(root / "near" / "seed-0", copied / "seed-0")
    return root


def test_the_same_episodes_under_another_name_are_told(copied):
    board = make_board([validate(copied / "near"), validate(copied / "copied")])
    same = {row.name: row.same_episodes_as for row in board.unranked}
    assert same == {"near": ("copied",), "copied": ("near",)}


def test_another_protocol_is_listed_apart_and_a_bad_one_left_out(submissions, tmp_path):
    root = tmp_path / "submissions"
    shutil.copytree(submissions, root)
    file = root / "near" / "seed-0" / "table4" / "run.json"
    run = read_run(file)
    digests = {**run.header.task_digests, "pushing": "0" * 64}
    file.write_bytes(run_json(replace(run, header=replace(run.header, task_digests=digests))))
    (root / "hac" / "submission.toml").unlink()
    (root / "README.md").write_text("hello")
    board = build_board(root, tmp_path / "board")
    assert list(map(len, (board.ranked, board.other_protocol, board.refused))) == [2, 1, 1]
    document = json.loads((tmp_path / "board" / "leaderboard.json").read_text())
    schema("leaderboard.schema.json").validate(document)
    assert [row["name"] for row in document["refused"]] == ["hac"]
    text = (tmp_path / "board" / "leaderboard.md").read_text()
    assert "## Other protocols, not ranked\n\n- **near**" in text
    assert "## Left out\n\n- **hac**" in text
    page = (tmp_path / "board" / "index.html").read_text()
    assert "Other protocols, not ranked" in page
    assert "submission/near.html" not in page


def test_a_hostile_method_is_only_text(board):
    hostile = replace(board, ranked=(replace(board.ranked[0], method="<script>|`x`"),))
    assert "<script" not in board_markdown(hostile, views(hostile)).replace("\\<script", "")


def test_the_board_does_not_depend_on_the_order_of_submissions(findings, board):
    assert make_board(findings[::-1]) == board


def without_a_level(path):
    proof = json.loads(path.with_name("scripted.json").read_text())
    path.write_text(json.dumps({**proof, "level": "remote"}))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_text("{"),
        lambda path: path.write_bytes(b" " * (MAX_PROOF + 1)),
        without_a_level,
        lambda path: path.symlink_to("scripted.json"),
    ],
)
def test_a_proof_that_cannot_be_read_costs_its_row_the_level_alone(submissions, tmp_path, spoil):
    root = tmp_path / "submissions"
    for name in ("near", "scripted"):
        shutil.copytree(submissions / name, root / name)
    (root / "_proofs").mkdir()
    shutil.copy(proof_path(submissions / "scripted"), root / "_proofs")
    spoil(proof_path(root / "near"))
    told = []
    assert build_board(root, tmp_path / "board", told.append).refused == ()
    board = json.loads((tmp_path / "board" / "leaderboard.json").read_text())
    assert [row["proof"] for row in board["unranked"]] == ["self-reported"]
    assert [row["proof"] for row in board["calibration"]] == ["verified"]
    assert any("near is listed without a proof" in line and "near.json" in line for line in told)


def test_estimates_are_computed_again_where_no_proof_is_for_these_bytes(submissions, tmp_path):
    root, file = tmp_path / "submissions", "near/seed-0/table4/run.json"
    shutil.copytree(submissions, root)
    run = read_run(root / "near/seed-0/table4")
    task = run.summary.tasks[1]
    steps = task.estimates["episode_steps"]
    estimates = {**task.estimates, "episode_steps": replace(steps, low=steps.low - 1)}
    tasks = (run.summary.tasks[0], replace(task, estimates=estimates), *run.summary.tasks[2:])
    edited = replace(run, summary=replace(run.summary, tasks=tasks))
    (root / file).write_bytes(run_json(edited))
    (refused,) = build_board(root, tmp_path / "board").refused
    assert "episode_steps.low" in refused.reasons[0]
