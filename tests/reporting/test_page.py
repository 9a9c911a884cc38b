import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from minitouch_bench.reporting.report import Video, build_report, to_html, write_page
from tests.reporting.html_page import Page
from tests.reporting.synthetic import make_run, save

CHROMIUM = shutil.which("chromium")


@pytest.fixture(scope="module")
def page(hac, scripted) -> str:
    return to_html(build_report([hac, scripted], [Video("pushing 3", "videos/pushing_3.mp4")]))


def test_tags_are_closed_and_ids_are_unique(page):
    parsed = Page(page)
    assert parsed.open == []
    # Equal drawings share a marker of equal content; everything else has a name of its own.
    own = [name for name in parsed.ids if not re.fullmatch(r"[mpC_\d][\da-f_]+", name)]
    assert len(own) == len(set(own))


def test_nothing_is_loaded_from_anywhere(page):
    for tag, attributes in Page(page).attributes:
        assert tag != "script"
        for name in ("src", "href", "xlink:href"):
            address = attributes.get(name) or ""
            assert address.startswith(("#", "data:", "videos/")) or not address, address
    assert "@import" not in page
    assert "default-src 'none'" in page


def test_key_figures_and_labels_are_on_the_page(page, hac):
    pushing = next(task for task in hac.summary.tasks if task.task == "pushing")
    assert f"{pushing.estimates['success'].value:.3f}" in page
    for text in (
        "unofficial: 5 of 100 episodes",
        "reads the simulator&#39;s state",
        "episode variance only",
        "act() gave NaN in element 2 of 4",
        hac.header.protocol_digest,
        "minitouch-bench evaluate checkpoints/hac-seed1.safetensors",
        '<video controls muted preload="metadata" src="videos/pushing_3.mp4">',
    ):
        assert text in page


def test_tables_can_be_reached_and_read_aloud(page):
    regions = [a for tag, a in Page(page).attributes if a.get("role") == "region"]
    assert all(region["tabindex"] == "0" and region["aria-labelledby"] for region in regions)
    assert len(regions) == 2 + 2  # Table 4, diagnostics, the episodes of each run
    heads = [a for tag, a in Page(page).attributes if tag == "th"]
    assert all(head["scope"] in {"col", "row", "colgroup"} for head in heads)


def test_every_episode_is_on_the_page(page, hac):
    for episode in hac.rows:
        assert f"{episode.task}/{episode.index}<" in page


def test_hostile_text_is_only_text(hostile):
    page = to_html(build_report([hostile]))
    assert Page(page).open == []
    assert "<script" not in page
    assert "\u202e" not in page
    assert "\x1b" not in page


def test_a_run_without_episodes_still_has_a_page():
    run = make_run(tasks=("pushing",), episodes=1)
    page = to_html(build_report([save(replace(run, records=()))]))
    assert Page(page).open == []


def test_one_task_of_one_run_has_a_page():
    page = to_html(build_report([save(make_run(tasks=("playing",), episodes=1))]))
    assert "Touch-interaction" in page
    assert "How long episodes last" not in page


def run_chromium(profile: Path, *options: str) -> subprocess.CompletedProcess[str]:
    quiet = ("--disable-quic", "--no-first-run", "--disable-background-networking")
    still = ("--disable-component-update", "--disable-sync", "--disable-gpu", "--no-sandbox")
    command = [str(CHROMIUM), "--headless", *quiet, *still, f"--user-data-dir={profile}", *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)


@pytest.mark.skipif(CHROMIUM is None, reason="needs a browser: apt-get install chromium")
def test_the_page_opens_in_a_browser_without_a_console_error(tmp_path, hac, scripted):
    write_page([hac, scripted], tmp_path)
    log = ("--enable-logging=stderr", "--v=0", "--dump-dom")
    page = (tmp_path / "report.html").as_uri()
    done = run_chromium(tmp_path / "profile", *log, page)
    assert "CONSOLE" not in done.stderr, done.stderr
    assert "2 policies, side by side" in done.stdout
    assert "RND+<wbr>touch" in done.stdout
    assert "var(--series-0)" in done.stdout


@pytest.mark.skipif(CHROMIUM is None, reason="needs a browser: apt-get install chromium")
def test_the_browser_test_would_see_a_console_error(tmp_path):
    (tmp_path / "bad.html").write_text("<script>console.error('seen')</script>")
    log = ("--enable-logging=stderr", "--v=0", "--dump-dom")
    done = run_chromium(tmp_path / "profile", *log, (tmp_path / "bad.html").as_uri())
    assert "CONSOLE" in done.stderr
