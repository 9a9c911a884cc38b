"""The site as a reader meets it: in a real browser, and as text for what a browser hides."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.leaderboard.ranking import BOARD_TASKS, OVERALL
from minitouch_bench.leaderboard.site import BOARD_FILE, build_board
from tests.leaderboard.browser import Browser
from tests.leaderboard.synthetic import ABOUT, NOON, make_row, make_submission
from tests.reporting.html_page import Page

HOSTILE = "</script><script>alert(1)</script>\u202e=cmd()"
ROWS = ".view:not([hidden]) tbody.ranked tr[data-name]:not([hidden])"


@pytest.fixture(scope="module")
def board(tmp_path_factory) -> Path:
    """A board of four ranked rows, a copy, a floor, and a submission that waits."""
    root = tmp_path_factory.mktemp("site")
    touch = replace(ABOUT, method="Touch alone", modalities=("touch",), training_steps=500_000)
    vision = replace(ABOUT, method="Vision alone", modalities=("vision",), training_steps=10**7)
    both = ("table4", "novel-shapes")
    own = b"weights of the best"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tests.reporting.synthetic.FAULT", HOSTILE)
        make_row(root, "hac", 0.9, suites=both, exploration=True, faults=2, content=own)
    make_row(root, "touch", 0.6, about=replace(touch, learner="PPO"))
    make_row(root, "vision", 0.3, about=vision)
    make_row(root, "seeds", 0.75, seeds=(0, 1))
    make_row(root, "copy", 0.9, at=NOON, content=own)
    make_row(root, "random", 0.1)
    make_submission(root / "submissions", "new")
    build_board(root / "submissions", root / "board", root / "results")
    return root / "board"


@pytest.fixture
def index(browser, board):
    browser.open(board / "index.html")
    return browser


def names(browser: Browser) -> list[str]:
    script = f"[...document.querySelectorAll({json.dumps(ROWS)})].map(r => r.cells[1].dataset.key)"
    return list(browser.run(script))


def text(browser: Browser, selector: str) -> str:
    return str(browser.run(f"document.querySelector({json.dumps(selector)}).textContent"))


# In a browser


def test_the_board_opens_without_a_complaint_and_loads_nothing_else(index, board):
    assert {*names(index)} == {"hac", "seeds", "touch", "vision"}
    assert text(index, ".count") == "4 ranked submissions"
    assert index.messages == []
    loaded = [url for url in index.requests if not url.startswith("data:")]
    assert loaded == [(board / "index.html").as_uri()]


def test_the_page_of_a_row_in_the_dark_alone_promises_nothing_it_lacks(browser, tmp_path):
    make_row(tmp_path, "blind", 0.8, suites=("dark",))
    build_board(tmp_path / "submissions", tmp_path / "board", tmp_path / "results")
    browser.open(tmp_path / "board" / "submission" / "blind.html")
    assert browser.messages == []
    assert browser.run("document.querySelector('.episode-section')") is None
    assert "evaluate submissions/blind/seed-0 --suite dark" in text(browser, "#facts ~ dl")


def test_columns_are_sorted_by_hand_and_by_keyboard(index):
    training = "#overall th:nth-last-child(2)"  # before the day of play
    index.click(f"{training} .sort")
    assert names(index)[0] == "touch"
    assert names(index)[-1] == "vision"
    index.run(f"document.querySelector('{training} .sort').focus()")
    index.press("Enter")
    assert names(index)[0] == "vision"
    assert index.run(f"document.querySelector('{training}').ariaSort") == "descending"
    index.click("#overall th.who .sort")
    assert names(index) == ["hac", "seeds", "touch", "vision"]


def test_rows_are_filtered_by_modality_and_words(index):
    index.click("input[value=touch]")
    assert {*names(index)} == {"hac", "seeds", "touch"}
    index.click("input[value=vision]")
    assert {*names(index)} == {"hac", "seeds"}
    assert text(index, ".count") == "2 of 4 ranked submissions"
    for value in ("touch", "vision"):
        index.click(f"input[value='{value}']")
    assert len(names(index)) == 4
    index.click(".search")
    index.write("alone PPO")
    assert names(index) == ["touch"]


def test_the_address_keeps_the_view_and_the_filters(index, board):
    index.click("#tab-pushing")
    index.click("input[value=touch]")
    index.click(".search")
    index.write("alone")
    address = index.run("location.hash")
    assert address == "#pushing?modality=touch&words=alone"
    index.open(board / "index.html")
    assert index.run("document.querySelector('.search').value") == ""
    index.open(board / "index.html", address)
    assert index.run("document.querySelector('.view:not([hidden])').id") == "pushing"
    assert index.run("document.querySelector('input[value=touch]').checked")
    assert text(index, ".count") == "1 of 4 ranked submissions"


@pytest.mark.parametrize("page", ["index.html", "submission/hac.html", "submission/seeds.html"])
def test_a_phone_s_width_needs_no_sideways_scrolling(browser, board, page):
    cut = "[...document.querySelectorAll('pre')].filter(e => e.scrollWidth > e.clientWidth).length"
    for width in (360, 390, 768, 1400):
        browser.screen(width, 800)
        browser.open(board / page)
        browser.run("document.querySelectorAll('details').forEach(one => { one.open = true; })")
        assert browser.run("document.documentElement.scrollWidth") <= width
        assert browser.run(cut) == 0
        assert browser.run("document.querySelector('.scroll').scrollWidth") >= 300


# As text


@pytest.mark.parametrize("page", ["index.html", "submission/hac.html", "submission/random.html"])
def test_pages_are_well_formed_and_hold_no_handlers_or_styles(board, page):
    parsed = Page((board / page).read_text())
    assert parsed.open == []
    assert len(parsed.ids) == len(set(parsed.ids))
    for tag, attributes in parsed.attributes:
        assert "style" not in attributes, tag
        assert not [name for name in attributes if name.startswith("on")], tag
        for name in ("src", "href"):
            assert not (attributes.get(name) or "").startswith(("javascript:", "http:", "//"))
    policy = next(a["content"] for t, a in parsed.attributes if "http-equiv" in a)
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy


def test_a_page_tells_limits_and_faults_as_text_and_every_board_what_waits(board):
    page, seeds = ((board / "submission" / f"{one}.html").read_text() for one in ("hac", "seeds"))
    for text in (
        "Episode variance only (one training seed)",
        "&lt;/script&gt;&lt;script&gt;alert(1)",
        "evaluate submissions/hac/seed-0",
        "Fresh episodes",
    ):
        assert text in page
    assert not any(text in page for text in ("<script>alert", "\u202e"))
    assert ("By training seed" in page, "By training seed" in seeds) == (False, True)
    for name in ("leaderboard.md", "index.html"):
        text = (board / name).read_text().replace("\\", "")
        assert "leaderboard play new" in text
        assert "a copy of hac" in text


def test_every_rank_is_explained(board):
    """On the board, in its Markdown and on the row's own page."""
    pairs = json.loads((board / "leaderboard.json").read_text())["pairs"]
    counts = {key: len(of_table) for key, of_table in pairs.items()}
    assert counts == dict.fromkeys((OVERALL, *BOARD_TASKS), 6) | {
        f"novel-shapes/{task}": 0 for task in ("playing", "pushing", "pick-up")
    }
    touch = 1  # the table of touch is in the overall order
    shown = 4 * (len(BOARD_TASKS) + 1 + touch)
    assert (board / "index.html").read_text().count(">Why this rank<") == shown
    text = (board / "leaderboard.md").read_text()
    found = {(pair["higher"], pair["lower"]) for pair in pairs["overall"] if pair["is_significant"]}
    assert ("hac", "vision") in found
    for name in ("hac", "seeds", "touch", "vision"):
        line = text.partition(f"\n- **{name}**: ")[2].partition("\n")[0]
        assert ("Significantly better than" in line) == any(name == one for one, _ in found)
        assert ("Significantly worse than" in line) == any(name == other for _, other in found)
        page = (board / "submission" / f"{name}.html").read_text().replace("\u00a0", " ")
        assert line.replace("\\<", "&lt;") in page


def test_pages_of_an_earlier_board_are_removed_and_nothing_else(tmp_path):
    outside, output = tmp_path / "outside", tmp_path / "board"
    for folder in (tmp_path / "submissions", outside):
        folder.mkdir()
    for name in ("notes.txt", "gone.html"):
        (outside / name).write_text("somebody's own")

    def build():
        build_board(tmp_path / "submissions", output, tmp_path / "results")
        assert len(list(outside.iterdir())) == 2
        assert (output / BOARD_FILE).is_file()

    build()
    pages = output / "submission"
    (pages / "gone").symlink_to(outside)
    (pages / "gone.html").symlink_to(outside / "gone.html")
    (pages / "old.html").touch()
    (pages / "mine").mkdir()
    build()
    assert {path.name for path in pages.iterdir()} == {"gone", "gone.html", "mine"}
    pages.rename(tmp_path / "moved")
    pages.symlink_to(outside)
    with pytest.raises(RunDirectoryError, match="submission"):
        build()
    assert len(list(outside.iterdir())) == 2
