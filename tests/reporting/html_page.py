"""A page of HTML as its tags and attributes; tags must be closed in their order."""

from html.parser import HTMLParser
from xml.etree import ElementTree

VOID = frozenset({"meta", "link", "img", "br", "wbr", "input"})


class Page(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.attributes: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)
        self.ids = [found["id"] for _, found in self.attributes if "id" in found]

    def handle_starttag(self, tag, attrs):
        self.attributes.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.attributes.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, tag


def table_texts(fragment: str) -> list[list[list[str]]]:
    """Return the tables of what a notebook shows: rows of cells, the heads first."""
    root = ElementTree.fromstring(f"<div>{fragment}</div>")
    return [
        [["".join(cell.itertext()) for cell in row] for row in table.iter("tr")]
        for table in root.iter("table")
    ]
