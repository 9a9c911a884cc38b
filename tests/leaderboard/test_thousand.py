"""A board of a thousand submissions: how long it takes to draw, and whether it answers."""

import os
import shutil

import pytest

from minitouch_bench.leaderboard.build import build_board
from tests.leaderboard.browser import CHROMIUM, Browser
from tests.leaderboard.thousand import make_many

pytestmark = pytest.mark.slow
NUMBER = 1000
LATE = "method-0500"
FEW = 50
MAX_ROW_GROWTH = 1.5
"""A row of a thousand costs at most so many times a row of FEW; every pair of rows is compared."""
MAX_ONE_MORE = 1 / 8
"""Of what the whole board costs."""
MAX_ANSWER_MS = 700.0
"""A sort of a thousand rows with its layout, on a machine that is busy with other tests."""


@pytest.fixture(scope="module")
def submissions(tmp_path_factory):
    root = tmp_path_factory.mktemp("thousand")
    make_many(root / "submissions", NUMBER + 1)
    shutil.move(root / "submissions" / LATE, root / LATE)
    return root / "submissions"


@pytest.fixture(scope="module")
def built(submissions):
    board = submissions.parent / "board"
    found, spent = timed(build_board, submissions, board)
    assert found.refused == ()
    return board, spent


def timed(function, *arguments):
    """Return what a function gives and its time on the processor, without what else runs."""
    before = os.times()
    found = function(*arguments)
    after = os.times()
    return found, sum(after[:4]) - sum(before[:4])


@pytest.mark.timeout(900)
def test_a_row_of_a_thousand_costs_little_more_than_one_of_few(built, tmp_path):
    board, seconds = built
    assert len(list((board / "submission").glob("*.html"))) == NUMBER
    make_many(tmp_path / "few", FEW)
    _, of_few = timed(build_board, tmp_path / "few", tmp_path / "board")
    assert seconds / NUMBER < MAX_ROW_GROWTH * of_few / FEW, (seconds, of_few)


@pytest.mark.timeout(900)
@pytest.mark.skipif(CHROMIUM is None, reason="needs a browser: apt-get install chromium")
def test_the_page_of_a_thousand_answers_at_once(built, tmp_path):
    browser = Browser(tmp_path / "profile")
    try:
        browser.screen(1280, 900)
        browser.open(built[0] / "index.html")
        for action in (
            "document.querySelector('#overall th:nth-last-child(2) .sort').click()",
            "document.querySelector('input[value=touch]').click()",
            "document.querySelector('#tab-pushing').click()",
        ):
            took = browser.run(
                f"(() => {{ const began = performance.now(); {action};"
                "document.body.getBoundingClientRect(); return performance.now() - began; })()"
            )
            assert took < MAX_ANSWER_MS, (action, took)
        shown = "document.querySelectorAll('#overall tbody.ranked tr:not([hidden])').length"
        browser.run("document.querySelector('input[value=touch]').click()")
        assert browser.run(shown) == 100
        assert browser.run("document.querySelector('.more').textContent") == f"Show all {NUMBER}"
        browser.run("document.querySelector('.more').click()")
        assert browser.run(shown) == NUMBER
        assert browser.messages == []
    finally:
        browser.close()


@pytest.mark.timeout(900)
def test_one_row_more_is_there_soon(built, submissions):
    board, whole = built
    shutil.move(submissions.parent / LATE, submissions / LATE)
    found, seconds = timed(build_board, submissions, board)
    assert (found.ranked, found.new) == (NUMBER + 1, 1)
    assert f"of {NUMBER + 1}<" in (board / "submission" / "method-0000.html").read_text()
    assert (board / "submission" / f"{LATE}.html").exists()
    assert seconds < MAX_ONE_MORE * whole, (seconds, whole)
