"""What stands on a board: the figures against the runs' own, ranks, copies, who is left out."""

import csv
import io
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from minitouch_bench.leaderboard import kept_rows
from minitouch_bench.leaderboard.board import CALIBRATION, ScoredSubmission, make_board
from minitouch_bench.leaderboard.board_files import board_csv, board_markdown
from minitouch_bench.leaderboard.build import build_board, score_submissions
from minitouch_bench.leaderboard.entries import Ending, Episodes
from minitouch_bench.leaderboard.kept_rows import file_state
from minitouch_bench.leaderboard.proof import (
    MAX_PROOF,
    ProofLevel,
    make_proof,
    proof_path,
    write_proof,
)
from minitouch_bench.leaderboard.scores import MEAN_SUCCESS, OVERALL, _gap
from minitouch_bench.leaderboard.site import index_html
from minitouch_bench.leaderboard.validation import validate
from minitouch_bench.leaderboard.views import views
from minitouch_bench.metrics.definitions import ranking_metric
from minitouch_bench.protocol.minitouch import GOAL_TASKS, TASK_NAMES
from minitouch_bench.reporting.run_directory import read_run, run_json
from tests.leaderboard.synthetic import make_submission

BOTH = ("table4", "novel-shapes")


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
def scored(submissions):
    return score_submissions(sorted(submissions.iterdir()))


@pytest.fixture(scope="module")
def board(scored):
    return make_board(scored)


@pytest.fixture(scope="module")
def rows(board):
    return {row.name: row for row in board.rows}


def test_figures_of_one_seed_are_those_of_its_run(submissions, rows):
    run = read_run(submissions / "hac" / "seed-0" / "table4")
    for task in run.summary.tasks:
        for metric in ("success", "exploration", "touched"):
            if metric in task.estimates:
                assert rows["hac"].estimate(task.task, metric) == task.estimates[metric]
        for metric in ("episode_steps", "touch_interaction", "touch_onsets", "time_to_first_touch"):
            if metric in task.estimates:
                mine, theirs = (
                    rows["hac"].estimate(task.task, metric),
                    task.estimates[metric],
                )
                width = theirs.high - theirs.low
                assert mine.value == pytest.approx(theirs.value, rel=1e-12)
                assert mine.count == theirs.count
                assert mine.low == pytest.approx(theirs.low, abs=0.08 * width)
                assert mine.high == pytest.approx(theirs.high, abs=0.08 * width)


def test_the_gap_of_one_seed_is_that_of_its_run(submissions, rows):
    run = read_run(submissions / "hac" / "seed-0" / "novel-shapes")
    for result in run.summary.generalization:
        mine = rows["hac"].novel_shapes[result.task]
        theirs = result.gaps[ranking_metric(result.task)]
        if result.task in GOAL_TASKS:
            assert mine == theirs
        else:
            width = theirs.difference.high - theirs.difference.low
            assert mine.difference.value == pytest.approx(theirs.difference.value, rel=1e-9)
            assert mine.difference.low == pytest.approx(theirs.difference.low, abs=0.08 * width)


def test_a_gap_over_two_seeds_is_no_narrower_than_over_their_episodes():
    is_held_out = np.arange(400) % 2 == 0
    listed = []
    for more in (2, 4):  # of 200: two seeds that agree in the sign, as half of all do
        values = np.ones(400)
        values[np.flatnonzero(is_held_out)[:more]] = 0.0
        none = np.zeros(400)
        listed.append(Episodes(none, none, {"success": values}, is_held_out, ()))
    gap = _gap(listed, "pushing")
    assert gap.difference.value == pytest.approx(-0.015)
    assert gap.difference.low < -0.02
    assert gap.train.value == 1.0 > gap.train.low


def test_several_seeds_are_averaged_and_resampled(submissions, rows):
    rates = [
        np.mean([e.success for e in read_run(place).episodes if e.task == "pushing"])
        for place in sorted((submissions / "seeds").glob("seed-*/table4"))
    ]
    found = rows["seeds"].estimate("pushing", "success")
    assert found.value == pytest.approx(np.mean(rates))
    assert found.count == 3
    assert "training seeds" in found.method
    assert found.low <= min(rates) + 1e-12
    assert found.high >= max(rates) - 1e-12
    steps = rows["seeds"].estimate("pushing", "episode_steps")
    means = [
        np.mean([e.steps for e in read_run(place).episodes if e.task == "pushing"])
        for place in sorted((submissions / "seeds").glob("seed-*/table4"))
    ]
    assert (steps.low, steps.high) == pytest.approx((min(means), max(means)))


def test_no_share_is_ever_certain(rows):
    for row in rows.values():
        for metric, found in (pair for own in row.figures.values() for pair in own.items()):
            if metric in ("success", "touched", MEAN_SUCCESS):
                assert found.low < found.high


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
    assert [row.name for row in board.calibration] == ["scripted"]
    assert rows["scripted"].ranks == {}
    assert board.missing_calibration == CALIBRATION[1:]


def test_every_episode_has_one_ending(scored, rows):
    counts = rows["hac"].endings
    assert all(sum(own.values()) == 100 for own in counts.values())
    assert counts["pushing"][Ending.FAULT] == 4
    (values,) = [
        one.values for one in scored if isinstance(one, ScoredSubmission) and one.row.name == "hac"
    ]
    won = sum(values["pushing"][0])
    assert counts["pushing"][Ending.SUCCEEDED] == won
    assert sum(rows["seeds"].endings["opening"].values()) == 300
    assert set(counts["playing"]) <= {Ending.TOUCHED, Ending.NEVER_TOUCHED}


def test_the_same_episodes_under_another_name_are_told(submissions, tmp_path):
    root = tmp_path / "submissions"
    shutil.copytree(submissions / "near", root / "near")
    copied = make_submission(root, "copied", 0.5)
    shutil.rmtree(copied / "seed-0")
    shutil.copytree(root / "near" / "seed-0", copied / "seed-0")
    places = [root / "near", copied]
    same = {
        row.name: row.same_episodes_as for row in make_board(score_submissions(places)).unranked
    }
    assert same == {"near": ("copied",), "copied": ("near",)}


def test_a_copy_without_a_rank_is_told_and_filtered_on_the_site(submissions, tmp_path):
    root = tmp_path / "submissions"
    shutil.copytree(submissions / "near", root / "near")
    (root / "_proofs").mkdir()
    shutil.copy(proof_path(submissions / "near"), root / "_proofs")
    copied = make_submission(root, "copied", 0.5, level=ProofLevel.SELF_REPORTED)
    shutil.rmtree(copied / "seed-0")
    shutil.copytree(root / "near" / "seed-0", copied / "seed-0")
    board = make_board(score_submissions([root / "near", copied]))
    (overall, *_) = index_html(board, views(board)).split("</section>")
    _, ranked, unranked, _ = overall.split("<tbody")
    for part, name, other in ((ranked, "near", "copied"), (unranked, "copied", "near")):
        assert f'data-name="{name} ' in part
        assert f"same episodes as {other}" in part
    assert 'data-proof="self-reported"' in unranked
    for level in ProofLevel:
        assert f'name="proof" value="{level}"' in overall


def test_another_protocol_is_listed_apart_and_a_bad_one_left_out(submissions, tmp_path):
    root = tmp_path / "submissions"
    shutil.copytree(submissions, root)
    file = root / "near" / "seed-0" / "table4" / "run.json"
    run = read_run(file)
    digests = {**run.header.task_digests, "pushing": "0" * 64}
    file.write_bytes(run_json(replace(run, header=replace(run.header, task_digests=digests))))
    (root / "hac" / "submission.toml").unlink()
    (root / "README.md").write_text("hello")
    built = build_board(root, tmp_path / "board")
    assert (built.ranked, built.apart, len(built.refused)) == (2, 1, 1)
    text = (tmp_path / "board" / "leaderboard.md").read_text()
    assert "## Other protocols, not ranked\n\n- **near**" in text
    assert "## Left out\n\n- **hac**" in text
    page = (tmp_path / "board" / "index.html").read_text()
    assert "Other protocols, not ranked" in page
    assert "submission/near.html" not in page


def test_an_empty_board_still_has_its_reference_rows(tmp_path):
    (tmp_path / "submissions").mkdir()
    build_board(tmp_path / "submissions", tmp_path / "board")
    page = (tmp_path / "board" / "index.html").read_text()
    assert "No ranked submission yet" in page
    assert page.count("not submitted yet") >= 3
    assert "0.891" in page


def test_csv_has_a_row_a_figure_and_guards_formulas(board):
    table = list(csv.DictReader(io.StringIO(board_csv(board))))
    (row,) = [
        row
        for row in table
        if (row["name"], row["task"], row["metric"]) == ("hac", "pushing", "success")
    ]
    assert row["rank"]
    assert float(row["low"]) < float(row["value"]) < float(row["high"])
    assert {row["kind"] for row in table} == {"ranked", "calibration", "paper"}
    assert not any(row["rank"] for row in table if row["kind"] != "ranked")
    text = board_csv(replace(board, ranked=(with_method(board.ranked[0], "=cmd()"),)))
    assert ",'=cmd()," in text
    hostile = replace(board, ranked=(with_method(board.ranked[0], "<script>|`x`"),))
    assert "<script" not in board_markdown(hostile, views(hostile)).replace("\\<script", "")


def with_method(row, method):
    return replace(row, method=method)


def test_the_board_does_not_depend_on_the_order_of_submissions(submissions, board):
    scored = score_submissions(sorted(submissions.iterdir(), reverse=True))
    assert board_csv(make_board(scored)) == board_csv(board)


def files_of(board):
    return {
        path.relative_to(board): path.read_bytes()
        for path in board.rglob("*")
        if path.is_file() and ".cache" not in path.parts
    }


def test_a_row_more_gives_the_board_that_all_rows_at_once_give(submissions, tmp_path):
    root = tmp_path / "submissions"
    shutil.copytree(submissions, root)
    late = shutil.move(root / "near", tmp_path / "near")
    assert build_board(root, tmp_path / "grown").new == 4
    assert build_board(root, tmp_path / "grown").new == 0
    shutil.move(late, root / "near")
    assert build_board(root, tmp_path / "grown").new == 1
    assert build_board(root, tmp_path / "whole").new == 5
    assert files_of(tmp_path / "grown") == files_of(tmp_path / "whole")


def test_what_changes_is_read_again_and_what_is_gone_is_forgotten(submissions, tmp_path):
    root, board = tmp_path / "submissions", tmp_path / "board"
    for name in ("near", "hac", "_proofs"):
        shutil.copytree(submissions / name, root / name)
    assert build_board(root, board).ranked == 2
    table = root / "near" / "seed-0" / "table4" / "table4.csv"
    text = table.read_text()
    table.write_text(text.replace("0", "1", 1))
    built = build_board(root, board)
    assert (built.ranked, built.new, [one.name for one in built.refused]) == (1, 1, ["near"])
    table.write_text(text)
    shutil.rmtree(root / "hac")
    assert build_board(root, board).ranked == 1
    assert len(list((board / ".cache").glob("*.json"))) == 1
    assert (board / ".cache" / ".gitignore").read_text() == "*\n"


@pytest.mark.parametrize("content", ["", "{}", "no json", '{"scored": {}, "refusal": null}'])
def test_a_kept_row_that_is_damaged_is_made_again(submissions, tmp_path, content):
    root, board = tmp_path / "submissions", tmp_path / "board"
    shutil.copytree(submissions / "near", root / "near")
    build_board(root, board)
    before = files_of(board)
    (kept,) = (board / ".cache").glob("*.json")
    kept.write_text(content)
    assert build_board(root, board).new == 1
    assert files_of(board) == before


def test_a_kept_row_without_its_page_is_made_again(submissions, tmp_path):
    root, board = tmp_path / "submissions", tmp_path / "board"
    shutil.copytree(submissions / "near", root / "near")
    build_board(root, board)
    (page,) = (board / ".cache").glob("*.html")
    page.unlink()
    assert build_board(root, board).new == 1


def test_files_that_have_not_changed_are_not_read_again(submissions, tmp_path, monkeypatch):
    root, board = tmp_path / "submissions", tmp_path / "board"
    shutil.copytree(submissions / "near", root / "near")
    assert file_state(root / "near") == ""  # too new to be trusted
    monkeypatch.setattr(kept_rows, "SETTLED_NS", 0)
    build_board(root, board)
    read = []
    hashed = kept_rows.submission_digest
    monkeypatch.setattr(kept_rows, "submission_digest", lambda one: read.append(one) or hashed(one))
    assert (build_board(root, board).new, read) == (0, [])
    table = root / "near" / "seed-0" / "table4" / "table4.csv"
    before = table.stat()
    table.write_text(table.read_text().replace("0", "1", 1))
    os.utime(table, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert build_board(root, board).refused  # of the same size and time, but not the same file
    assert read == [root / "near"]


def write_debris(path):
    path.write_text("{")


def write_bytes_that_are_no_text(path):
    path.write_bytes(b"\xff\x00" * 9)


def write_too_much(path):
    path.write_bytes(b" " * (MAX_PROOF + 1))


def write_no_level(path):
    proof = json.loads(path.with_name("scripted.json").read_text())
    path.write_text(json.dumps({**proof, "level": "remote"}))


def link_elsewhere(path):
    path.symlink_to("scripted.json")


def link_nowhere(path):
    path.symlink_to("gone.json")


@pytest.mark.parametrize(
    "spoil",
    [
        os.mkfifo, Path.mkdir, write_debris, write_bytes_that_are_no_text, write_too_much,
        write_no_level, link_elsewhere, link_nowhere,
    ],
)  # fmt: skip
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
    assert [row["proof"] for row in board["calibration"]] == ["re-run-verified"]
    assert any("near is listed without a proof" in line and "near.json" in line for line in told)


def test_a_proof_changes_its_row(submissions, tmp_path):
    root, board = tmp_path / "submissions", tmp_path / "board"
    shutil.copytree(submissions / "near", root / "near")
    build_board(root, board)
    verdict = validate(root / "near")
    write_proof(make_proof(verdict, ProofLevel.REPLAYED), proof_path(root / "near"))
    assert build_board(root, board).new == 1
    assert "replay-verified" in (board / "submission" / "near.html").read_text()
