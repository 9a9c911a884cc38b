"""What stands on a board: the figures against the runs' own, ranks, copies, who is left out."""

import gzip
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.episode import Role
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.evaluation.engine import SILENT
from minitouch_bench.json_io import plain, write_toml
from minitouch_bench.leaderboard.board import FLOORS, find_copies, in_order, make_board
from minitouch_bench.leaderboard.board_tables import board_markdown, views
from minitouch_bench.leaderboard.play import (
    ROW_FILE,
    Entry,
    FreshDraw,
    PlayedRow,
    RowFacts,
    play_row,
)
from minitouch_bench.leaderboard.ranking import (
    BOARD_METRICS,
    BOARD_TASKS,
    FLOOR_SUCCESS,
    MEAN_SUCCESS,
    OVERALL,
    board_key,
    count_learned,
    score,
)
from minitouch_bench.leaderboard.site import build_board, read_rows
from minitouch_bench.metrics.definitions import METRICS, ranking_metric
from minitouch_bench.metrics.intervals import over_seeds
from minitouch_bench.metrics.summary import Gap
from minitouch_bench.policies.sources import CheckpointFile, SubmittedTraining
from minitouch_bench.protocol.minitouch import GOAL_TASKS, TASK_NAMES
from minitouch_bench.reporting.labels import estimate_cell
from tests.altered import ROOT
from tests.leaderboard.synthetic import (
    ABOUT,
    MORNING,
    NOON,
    entry_of,
    make_row,
    make_submission,
)
from tests.leaderboard.test_submission import schema

BOTH = ("table4", "novel-shapes")


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    root = tmp_path_factory.mktemp("board")
    make_row(root, "hac", 0.9, suites=BOTH, exploration=True, faults=4)
    make_row(root, "near", 0.83)
    make_row(root, "seeds", 0.6, seeds=(0, 1, 2), suites=BOTH)
    make_row(root, "perfect", 1.0, seeds=(3, 4))
    make_row(root, "scripted", 1.0)
    return root


@pytest.fixture(scope="module")
def built(root, tmp_path_factory):
    output = tmp_path_factory.mktemp("built") / "board"
    build_board(root / "submissions", output, root / "results")
    return output


@pytest.fixture(scope="module")
def played(root):
    found, waiting, left_out = read_rows(root / "submissions", root / "results")
    assert (waiting, left_out) == ([], [])
    return {one.submission.name: one for one in found}


@pytest.fixture(scope="module")
def board(played):
    return make_board([*played.values()])


@pytest.fixture(scope="module")
def rows(board):
    return {row.name: row for row in board.rows}


def test_every_interval_on_the_board_is_that_of_its_runs(played, built):
    """Those of one seed are in its run.json; of several, ``over_seeds`` of those."""
    document = json.loads((built / "leaderboard.json").read_text())
    schema("leaderboard.schema.json").validate(document)
    compared = 0
    for row in (*document["ranked"], *document["calibration"]):
        for name, runs_of in (("figures", "official"), ("fresh", "fresh")):
            runs = getattr(played[row["name"]], runs_of)
            for task in TASK_NAMES:
                estimates = [run[task].estimates for run in runs["table4"]]
                for metric, figure in row[name][task].items():
                    possible = METRICS[metric].range_in(task)
                    assert figure == plain(over_seeds([one[metric] for one in estimates], possible))
                    assert len(estimates) > 1 or figure == plain(estimates[0][metric])
                    compared += 1
                shown = {one for one in BOARD_METRICS if all(one in each for each in estimates)}
                assert row[name][task].keys() == shown
        for task, gap in row["novel_shapes"].items():
            metric = ranking_metric(task)
            gaps = [
                result.gaps[metric]
                for run in played[row["name"]].official["novel-shapes"]
                for result in run.summary.generalization
                if result.task == task
            ]
            for part in Gap.__annotations__:
                parts = [getattr(one, part) for one in gaps]
                possible = (-1.0, 1.0) if part == "difference" else (0.0, 1.0)
                assert gap[part] == plain(over_seeds(parts, possible))
                compared += 1
            key = board_key("novel-shapes", task)
            assert row["figures"][key] == {metric: gap["held_out"]}
    assert compared > 300


def test_every_interval_on_the_pages_is_that_of_the_board(built, rows):
    shown = (built / "leaderboard.md").read_text().replace("\\", "")
    for row in rows.values():
        page = (built / "submission" / f"{row.name}.html").read_text()
        for task in TASK_NAMES:
            for metric, figure in row.figures[task].items():
                cell = estimate_cell(metric, figure)
                assert f"{cell.text} <small>{cell.small}</small>" in page
                assert f"{cell.text} {cell.small}" in shown


def test_the_overall_mean_does_not_depend_on_the_numbers_of_the_seeds(played):
    """The trainings of one task are independent of those of another."""
    runs = played["seeds"].official["table4"]
    turned = [
        replace(run, summary=replace(run.summary, tasks=tuple(
            runs[(index + shift) % len(runs)].summary.tasks[shift]
            for shift in range(len(run.summary.tasks))
        )))
        for index, run in enumerate(runs)
    ]  # fmt: skip
    assert turned[0].summary.tasks != runs[0].summary.tasks
    assert score({"table4": turned}) == score({"table4": runs})
    keys = [*score({"dark": runs, "table4": runs})]  # in every process
    assert keys[-2:] == [OVERALL, "dark"]


def test_a_seed_has_learned_where_it_is_above_the_best_floor(played, rows):
    runs = played["seeds"].official["table4"]
    assert count_learned({"table4": runs}) == dict.fromkeys(GOAL_TASKS, 3)
    assert rows["seeds"].learned == dict.fromkeys(GOAL_TASKS, 3)
    in_the_dark = count_learned({"dark": runs[:1]})
    assert in_the_dark == {"dark/opening": 1, "dark/pick-up": 1}
    assert rows["hac"].learned_in("pushing") == ""
    assert rows["seeds"].learned_in("pushing") == "3 of 3 seeds learned"


def test_the_floors_are_those_of_the_stored_rows():
    results = ROOT / "reports" / "results"
    stored = [Entry.open(ROOT / "submissions" / name, results).read() for name in FLOORS]
    runs = [one.official["table4"][0] for one in stored]
    best = {task: max(run[task].success.value for run in runs) for task in GOAL_TASKS}
    assert best == FLOOR_SUCCESS
    assert sum(count_learned({"table4": runs}).values()) == 0


def test_a_row_s_numbers_follow_from_its_episodes(rows):
    row = rows["hac"]
    parts = [row.estimate(task, "success") for task in GOAL_TASKS]
    found = row.estimate(OVERALL, MEAN_SUCCESS)
    assert found.value == pytest.approx(np.mean([part.value for part in parts]))
    assert found.low > np.mean([part.low for part in parts])  # three errors do not add up
    assert found.count == 300


def test_ranks_are_shared_where_rows_cannot_be_told_apart(board, rows):
    assert {row.name for row in board.ranked} == {"perfect", "hac", "near", "seeds"}
    assert board.ranked[0].name == "perfect"
    assert rows["hac"].ranks[OVERALL] == rows["near"].ranks[OVERALL]
    assert rows["seeds"].ranks[OVERALL].best == 4
    own = {OVERALL, *BOARD_TASKS}
    assert {*rows["near"].ranks} == own
    novel = {board_key("novel-shapes", task) for task in ("playing", "pushing", "pick-up")}
    assert {*rows["hac"].ranks} == own | novel
    assert len(board.pairs["novel-shapes/pushing"]) == 1


def with_value(row, name, value, seeds, high):
    estimate = replace(row.figures[OVERALL][MEAN_SUCCESS], value=value, high=high)
    figures = {**row.figures, OVERALL: {MEAN_SUCCESS: estimate}}
    return replace(row, name=name, figures=figures, training_seeds=tuple(range(seeds)))


def test_a_row_of_one_training_is_below_every_row_whose_interval_reaches_it(rows):
    listed = [
        with_value(rows["hac"], *one)
        for one in (
            ("best", 0.9, 5, 0.95),
            ("wide", 0.5, 5, 0.85),
            ("narrow", 0.6, 5, 0.62),
            ("lucky", 0.8, 1, 0.9),
            ("luckier", 0.82, 1, 0.9),
            ("above all", 0.97, 1, 1.0),
            ("low", 0.1, 1, 0.2),
        )
    ]
    names = [row.name for row in in_order(listed, OVERALL)]
    assert names == ["above all", "best", "narrow", "wide", "luckier", "lucky", "low"]


def test_calibrations_have_no_rank(board, rows):
    assert [row.name for row in board.calibration] == ["scripted"]
    assert rows["scripted"].ranks == {}


def build(root):
    return build_board(root / "submissions", root / "board", root / "results")


def test_a_copy_and_a_row_that_drops_have_no_rank_and_no_part_in_the_tests(tmp_path):
    """The row that was played first keeps its rank, whatever the names."""
    own = b"weights of the first"
    make_row(tmp_path, "original", 0.9, at=MORNING, content=own)
    make_row(tmp_path, "other", 0.5)
    alone = {row.name: row.ranks for row in build(tmp_path).ranked}
    for number in range(2):
        make_row(tmp_path, f"a-copy-{number}", 0.9, at=NOON, content=own)
    make_row(tmp_path, "equal-episodes", 0.5, at=NOON)
    make_row(tmp_path, "table", 1.0, fresh_skill=0.2)
    board = build(tmp_path)
    assert {row.name: row.ranks for row in board.ranked} == alone
    assert {row.name: row.copy_of for row in board.unranked} == {
        "a-copy-0": "original",
        "a-copy-1": "original",
        "equal-episodes": "other",
        "table": "",
    }
    assert len(board.pairs[OVERALL]) == 1
    turned = tmp_path / "turned"
    make_row(turned, "original", 0.5, suites=BOTH)
    make_row(turned, "later", 0.5, suites=BOTH[::-1], at=NOON)
    assert {row.name: row.copy_of for row in build(turned).unranked} == {"later": "original"}
    for name, reason in (("a-copy-1", "a copy of original"), ("table", "worse in fresh episodes")):
        assert reason in (tmp_path / "board" / "submission" / f"{name}.html").read_text()


def test_one_task_of_another_row_makes_a_copy(tmp_path):
    """The later row has the first row's episodes of Pushing and the second one's of Opening."""
    make_row(tmp_path, "one", 0.9)
    make_row(tmp_path, "two", 0.5)
    make_row(tmp_path, "collage", 0.7, at=NOON)
    played, _, _ = read_rows(tmp_path / "submissions", tmp_path / "results")
    assert make_board(played).unranked == ()
    collage, one, two = (row.official["table4"][0] for row in played)
    taken = {"pushing": one.rows, "opening": two.rows}
    rows = [
        row for task in collage.tasks for row in taken.get(task, collage.rows) if row.task == task
    ]
    played[0] = replace(played[0], official={"table4": (replace(collage, rows=tuple(rows)),)})
    assert find_copies({row.submission.name: row for row in played}) == {"collage": "one"}


def test_one_checkpoint_of_another_row_makes_a_copy():
    def row(name, at, **digests):
        files = (
            CheckpointFile(Role.FINAL, task, f"{task}.safetensors", 64 * digit)
            for task, digit in digests.items()
        )
        training = SubmittedTraining(0, tuple(files))
        draw = FreshDraw(0, training.digest(Role.FINAL), "", "ab" * 32, at, "Xeon")
        submission = replace(ABOUT, name=name, trainings=(training,))
        return PlayedRow(submission, RowFacts((draw,)), {}, {})

    first = row("first", MORNING, pushing="a", opening="b")
    later = row("later", NOON, pushing="c", opening="b")
    other = row("other", NOON, pushing="c", opening="d")
    assert find_copies({"later": later, "first": first}) == {"later": "first"}
    assert find_copies({"other": other, "first": first}) == {}


def test_a_training_taken_out_after_its_play_is_named(tmp_path):
    entry = make_row(tmp_path, "chosen", 0.7, seeds=(0, 1, 2))
    shutil.rmtree(entry.directory)
    make_submission(tmp_path / "submissions", "chosen", (0, 2), about=entry.submission)
    assert [one.name for one in build(tmp_path).waiting] == ["chosen"]
    play_row(entry_of(entry.directory), None, SILENT)  # which has no episode left to play
    (row,) = build(tmp_path).ranked
    assert row.training_seeds == (0, 2)
    assert "1 training played, then taken out or replaced" in row.labels


def test_what_is_not_played_waits_with_its_command(tmp_path):
    make_submission(tmp_path / "submissions", "new", about=replace(ABOUT, suites=BOTH))
    entry = make_row(tmp_path, "slow", 0.7, suites=BOTH)
    row = replace(entry.read_row(), played=("table4",), waiting="it would take 9 hours")
    shutil.rmtree(entry.results / "seed-0" / "novel-shapes-fresh")
    (entry.results / ROW_FILE).write_text(write_toml(row))
    board = build(tmp_path)
    waiting = {one.name: one.reason for one in board.waiting}
    assert "table4, novel-shapes: not played yet" in waiting["new"]
    assert waiting["slow"] == "novel-shapes: it would take 9 hours"
    assert [row.name for row in board.ranked] == ["slow"]
    assert board.ranked[0].novel_shapes == {}


def test_the_suite_dark_has_a_table_and_ranks_of_its_own(tmp_path):
    make_row(tmp_path, "feels", 0.8, suites=("dark",), seeds=(0, 1))
    make_row(tmp_path, "guesses", 0.2, suites=("table4", "dark"))
    board = build(tmp_path)
    (dark,) = (view for view in views(board) if view.title == "Dark")
    assert [(line.name, line.rank.best) for line in dark.lines] == [("feels", 1), ("guesses", 2)]
    shown = [cell.small.partition("], ")[2] for cell in dark.lines[0].cells]
    assert [text for text in shown if text] == [
        "4 of 4 trainings learned",
        *["2 of 2 seeds learned"] * 2,
    ]
    for name, tables in (("feels", ["In the dark"]), ("guesses", ["All values", "In the dark"])):
        page = (tmp_path / "board" / "submission" / f"{name}.html").read_text()
        assert [title for title in ("All values", "In the dark") if f"{title}<" in page] == tables
    (overall,) = (view for view in views(board) if view.title == "Overall")
    assert [line.name for line in overall.lines if line.rank] == ["guesses"]


@pytest.mark.parametrize(
    ("before", "now", "content"), [((0,), (0,), b"others"), ((0, 1), (0, 1, 2), b"")]
)
def test_a_row_with_a_new_checkpoint_waits_until_it_is_played(tmp_path, before, now, content):
    make_row(tmp_path, "other", 0.7)
    make_row(tmp_path, "changed", 0.7, before)
    make_submission(tmp_path / "submissions", "changed", now, content=content)
    board = build(tmp_path)
    assert [one.name for one in board.waiting] == ["changed"]
    assert [row.name for row in board.rows] == ["other"]


NEAR = "results/near/seed-0/table4"


def edit_run(folder, before, after):
    """Write something else in a result."""
    file = folder / "run.json.gz"
    content = gzip.decompress(file.read_bytes())
    assert before in content
    file.write_bytes(gzip.compress(content.replace(before, after)))


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (lambda at: (at / "submissions/near/submission.toml").unlink(), "submission.toml"),
        (lambda at: shutil.rmtree(at / "submissions/near"), "without a submission"),
        (lambda at: (at / "results/near/row.toml").write_text("{"), "row.toml"),
        (lambda at: shutil.copy(at / f"{NEAR}-fresh/run.json.gz", at / NEAR), "other episodes"),
        (lambda at: edit_run(at / NEAR, b'"step_limit"', b'"success"'), "digest"),
        (lambda at: edit_run(at / NEAR, b'"sandbox"', b'"none"'), "official"),
    ],
)
def test_what_cannot_be_shown_is_named_and_the_others_stay(root, tmp_path, spoil, word):
    shutil.copytree(root, tmp_path / "copy")
    spoil(tmp_path / "copy")
    board = build(tmp_path / "copy")
    (left_out,) = board.left_out
    assert left_out.name == "near"
    assert word in left_out.reason
    assert "near" not in {row.name for row in board.rows}
    assert len(board.ranked) == 3
    assert not (tmp_path / "copy" / "board" / "submission" / "near.html").exists()


@pytest.mark.parametrize("other", ["index.html", "leaderboard.json"])
def test_a_folder_that_is_not_a_board_is_not_written_to(root, tmp_path, other):
    (tmp_path / other).write_text("{}")
    (tmp_path / "submission").mkdir()
    (tmp_path / "submission" / "mine.html").write_text("somebody's page")
    with pytest.raises(RunDirectoryError, match="not empty"):
        build_board(root / "submissions", tmp_path, root / "results")
    assert (tmp_path / "submission" / "mine.html").read_text() == "somebody's page"


def test_the_board_does_not_depend_on_the_order_and_a_hostile_method_is_text(played, board):
    assert make_board([*played.values()][::-1]) == board
    hostile = replace(board, ranked=(replace(board.ranked[0], method="<script>|`x`"),))
    assert "<script" not in board_markdown(hostile, views(hostile)).replace("\\<script", "")
