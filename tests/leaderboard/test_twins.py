import hashlib
from dataclasses import replace

import numpy as np

from minitouch_bench.documents import write_json
from minitouch_bench.leaderboard.board import make_board
from minitouch_bench.leaderboard.board_files import board_csv, board_markdown
from minitouch_bench.leaderboard.build import score_submissions
from minitouch_bench.leaderboard.site import index_html
from minitouch_bench.leaderboard.twins import near_twins, sketch_of
from minitouch_bench.leaderboard.views import views
from tests.leaderboard.synthetic import make_submission

PLACE = "seed-0/table4"


def episodes(seed, size=4, number=400):
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 60, number)
    return [rng.uniform(-1, 1, (length, size)).astype(np.float32) for length in lengths]


def digest_of(text):
    return hashlib.sha256(text.encode()).hexdigest()


def noisy(actions, scale):
    rng = np.random.default_rng(9)
    return [
        np.clip(one + rng.normal(0, scale, one.shape), -1, 1).astype(np.float32) for one in actions
    ]


def test_the_distance_of_sketches_is_that_of_the_actions():
    actions = episodes(0)
    for scale in (0.01, 0.03, 0.3):
        other = noisy(actions, scale)
        true = np.sqrt(
            sum(float(((a - b)[:8] ** 2).sum()) for a, b in zip(actions, other, strict=True))
            / (len(actions) * 8 * 5)
        )
        found = np.linalg.norm(np.subtract(sketch_of(actions), sketch_of(other)))
        assert 0.6 * true < found < 1.5 * true


def test_a_copy_with_noise_is_told_in_every_format(tmp_path):
    names = {"first": episodes(0), "copied": noisy(episodes(0), 0.02), "other": episodes(1)}
    places = [make_submission(tmp_path / "submissions", name, 0.5) for name in names]
    scored = [
        replace(one, sketches={PLACE: sketch_of(actions)})
        for one, actions in zip(score_submissions(places), names.values(), strict=True)
    ]
    sketches = {one.row.name: one.sketches.values() for one in scored}
    assert near_twins(sketches) == {"first": ("copied",), "copied": ("first",)}
    apart = [
        replace(one, row=replace(one.row, runs={PLACE: digest_of(one.row.name)})) for one in scored
    ]  # not the same bits
    board = make_board(apart)
    told = "nearly the actions of first"
    tables = views(board)
    for text in (board_csv(board), board_markdown(board, tables), index_html(board, tables)):
        assert told in text
        assert "nearly the actions of other" not in text
    assert b'"nearly_same_actions_as": [\n    "first"' in write_json(board)
