"""Generated pages of the reference are those of the code; what pages link to exists."""

import re
from pathlib import Path

import pytest

from benchmarks.reference import GENERATORS, PAGES
from minitouch_bench import errors

ROOT = Path(__file__).parents[1]
WRITTEN = sorted(
    path
    for folder in ("reference", "explanation", "results")
    for path in (ROOT / "docs" / folder).glob("*.md")
)


@pytest.mark.parametrize("name", GENERATORS)
def test_a_generated_page_is_that_of_the_code(name):
    published = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    assert published == GENERATORS[name](), "run `make reference`"


def test_every_error_of_the_table_of_exit_codes_exists():
    page = (PAGES / "exit-codes.md").read_text(encoding="utf-8")
    named = {*re.findall(r"`(\w+Error)`", page)}
    assert named == {name for name in vars(errors) if name.endswith("Error")}
    for line in page.splitlines():
        code = re.match(r"\| (\d+) ", line)
        for name in re.findall(r"`(\w+Error)`", line) if code else ():
            assert getattr(errors, name).exit_code == int(code[1]), name


@pytest.mark.parametrize("page", WRITTEN, ids=lambda page: page.stem)
def test_pictures_and_pages_that_a_page_names_exist(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text):
        path = (page.parent / target).resolve()
        is_elsewhere = path.parent.name in ("how-to", "start", "project")
        assert is_elsewhere or path.exists(), target
