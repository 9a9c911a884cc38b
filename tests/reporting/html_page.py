"""A page of HTML as its tags and attributes; tags must be closed in their order."""

from html.parser import HTMLParser

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
