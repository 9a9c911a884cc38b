import re

import pytest

from benchmarks.reference import GENERATORS, PAGES
from minitouch_bench import errors


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
