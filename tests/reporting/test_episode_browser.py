import json
import shlex
from dataclasses import replace

import pytest

from minitouch_bench.reporting.endings import Ending
from minitouch_bench.reporting.pages import BrowsedRun, browser_data
from minitouch_bench.reporting.report import build_report, write_page
from tests.process_tree import wait_until
from tests.reporting.synthetic import make_run, write

CELLS = "[...document.querySelectorAll('.episodes tbody tr')].map(r => r.cells[{}].textContent)"


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The page of a run of which a viewer was made, and one of two runs elsewhere."""
    root = tmp_path_factory.mktemp("two words")
    runs = [write(make_run(name, faults=2), root / name) for name in ("hac", "rnd")]
    (root / "hac/replays").mkdir()
    viewer = root / "hac/replays/pushing-1.html"
    viewer.write_text("<title>the viewer</title>")
    made = build_report(runs[:1], directory=root / "hac", viewers={"pushing/1": viewer})
    write_page(made, root / "hac")
    write_page(build_report(runs, directory=root / "comparison"), root / "comparison")
    return root


def choose(browser, name, value):
    box = f"document.getElementById('{name}')"
    browser.run(f"{box}.value = '{value}'; {box}.dispatchEvent(new Event('change'))")


def test_failures_come_first_and_a_viewer_opens_where_there_is_one(browser, pages):
    browser.open(pages / "hac/report.html")
    endings = [Ending(text) for text in browser.run(CELLS.format(1))]
    assert endings[:2] == [Ending.FAULT] * 2
    assert endings == sorted(endings, key=[*Ending].index, reverse=True)
    choose(browser, "by-ending", "failures")
    ended = set(browser.run(CELLS.format(1)))
    assert "policy fault" in ended
    assert not ended & {"succeeded", "touched"}
    assert browser.run("document.getElementById('by-run').parentElement.hidden")
    choose(browser, "by-task", "pushing")
    assert browser.run(CELLS.format(7))[:2] == ["Replay", "View"]
    browser.click(".episodes tbody button.pick")
    assert browser.run("document.getElementById('replay-command').textContent") == (
        shlex.join(["minitouch-bench", "replay", str(pages / "hac"), "pushing/0"])
    )
    assert browser.messages == []
    browser.click(".episodes tbody a.pick")
    wait_until(lambda: browser.run("document.title") == "the viewer")


def test_a_policy_fault_has_the_touch_share_of_the_tables(hac):
    """Of all 200 steps, of which it played one."""
    touched = tuple(replace(row, touch_steps=row.steps) for row in hac.rows)
    data = json.loads(browser_data([BrowsedRun("hac", replace(hac, rows=touched))]))
    (pushing,) = [one for one in data["runs"][0]["groups"] if one["key"] == "pushing"]
    assert pushing["share"][:3] == [0.0, 0.005, 1.0]


def test_a_dot_of_a_map_leads_to_its_episode(browser, pages):
    browser.open(pages / "comparison/report.html")
    # The dot of the second run's third episode of Opening, as a circle that can be clicked.
    where = """(() => {
      const svg = document.querySelector("[data-source='1 opening']");
      const path = [...svg.querySelectorAll("[data-episodes]")].find(
        (one) => one.dataset.episodes.split(" ").includes("3"));
      const place = path.dataset.episodes.split(" ").indexOf("3");
      const at = [...path.getAttribute("d").matchAll(/M(\\S+) (\\S+?)h0/g)][place];
      const dot = document.createElementNS(svg.namespaceURI, "circle");
      const shape = { id: "dot", cx: at[1], cy: at[2], r: 1 };
      for (const [name, value] of Object.entries(shape)) dot.setAttribute(name, value);
      svg.append(dot);
    })()"""
    browser.run(where)
    browser.click("#dot")
    assert browser.run("document.getElementById('by-run').value") == "1"
    current = "document.querySelector('.episodes tr[aria-current]').cells[0].textContent"
    assert browser.run(current) == "opening/3"
    assert browser.run("document.getElementById('replay-command').textContent").endswith(
        "opening/3"
    )
    assert browser.messages == []
