"""One word, one meaning: no two modules or public classes of one name."""

import ast
from collections import defaultdict
from pathlib import Path

import minitouch_bench

PACKAGE = Path(minitouch_bench.__file__).parent
MODULES = {path.relative_to(PACKAGE): path for path in sorted(PACKAGE.rglob("*.py"))}

NAMED_AFTER = ("commands",)
"""Folders whose modules are named after a command, as the module that does the work."""


def definitions(*kinds):
    """Yield (module, name) of every definition of these kinds at the top of a module."""
    for relative, path in MODULES.items():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, kinds):
                yield relative, node.name


def test_no_two_modules_have_one_name():
    places = defaultdict(list)
    for relative in MODULES:
        is_named_after = relative.parent.as_posix() in NAMED_AFTER
        if not relative.stem.startswith("__") and not is_named_after:
            places[relative.stem].append(relative.as_posix())
    assert not {name: found for name, found in places.items() if len(found) > 1}


def test_no_two_public_classes_have_one_name():
    places = defaultdict(list)
    for relative, name in definitions(ast.ClassDef):
        if not name.startswith("_"):
            places[name].append(relative.as_posix())
    assert not {name: found for name, found in places.items() if len(found) > 1}
