"""No link in the pages is dead, and the navigation has every page of the site."""

import re

import pytest

from tests.altered import DOCS, ROOT

PLACES = ("*.md", "docs/**/*.md", "experiments/**/*.md", "examples/**/*.md", "examples/*.ipynb")
PAGES = sorted(page for place in PLACES for page in ROOT.glob(place))
CODE = re.compile(r"^```.*?^```|`[^`\n]*`", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(\s*<?([^)\s>]+)>?\s*\)|^\[[^\]]+\]: (\S+)$", re.MULTILINE)
REFERENCE = re.compile(r"\]\[([^\]]+)\]")
HEADING = re.compile(r"^#{1,6} +(.+?) *$", re.MULTILINE)
OURS = re.compile(
    r"https://(?:colab\.research\.google\.com/github|github\.com)/OWNER/minitouch-bench/blob/main/"
)
ELSEWHERE = ("https:", "http:", "mailto:")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere_and_every_reference_has_its_address(page):
    text = CODE.sub("", page.read_text(encoding="utf-8"))
    links = [inline or defined for inline, defined in LINK.findall(text)]
    assert not [link for link in links if not leads_somewhere(page, link)]
    defined = set(re.findall(r"^\[([^\]]+)\]: ", text, re.MULTILINE))
    assert not {*REFERENCE.findall(text)} - defined


def test_every_page_of_the_site_is_in_its_navigation():
    named = re.findall(r"^ +- .+: (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE)
    pages = {str(page.relative_to(DOCS)) for page in PAGES if DOCS in page.parents}
    assert pages == set(named)


def leads_somewhere(page, link):
    place = page.parent
    if ours := OURS.match(link):
        place, link = ROOT, link[ours.end() :]
    elif link.startswith(ELSEWHERE):
        return True
    path, _, anchor = link.partition("#")
    target = (place / path).resolve() if path else page
    if not target.exists() or not target.is_relative_to(ROOT):
        return False
    return not anchor or anchor in anchors(target)


def anchors(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    plain = (re.sub(r"[^\w\s-]", "", one.lower()).strip() for one in HEADING.findall(text))
    return {re.sub(r"[-\s]+", "-", heading) for heading in plain}
