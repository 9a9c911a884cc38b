import re

from minitouch_bench.comparison.comparison import compare_runs
from minitouch_bench.comparison.comparison_page import LISTED_CHANGES, comparison_html
from tests.comparison.pairs import with_actions
from tests.comparison.test_comparison import BAD, GOOD, GOOD_TOO, PATHS
from tests.reporting.html_page import Page


def test_the_page_has_a_map_and_a_table_of_each_pair_and_ten_commands(tmp_path):
    runs = [with_actions(run, tmp_path) for run in (GOOD, BAD, GOOD_TOO)]
    html = comparison_html(compare_runs(runs, PATHS), runs)
    page = Page(html)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert {"pair-B", "pair-C", "maps-B", "maps-C", "pair-B-changes"} <= set(page.ids)
    commands = re.findall(r"replay runs/good (\S+) --beside &#39;runs/bad one&#39;", html)
    assert len(commands) == LISTED_CHANGES
    pairs = zip(GOOD.rows, BAD.rows, strict=True)
    lost = sum(a.success and not b.success for a, b in pairs if a.task != "playing")
    counted = sum(map(int, re.findall(r"B against A: gained \d+, lost (\d+)", html)[:3]))
    assert counted == lost  # the fourth is Playing's, which has no success
    assert not re.search(r"(src|href)=\"https?:", html)
