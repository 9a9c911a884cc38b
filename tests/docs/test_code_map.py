"""The code map names what exists."""

import ast
import re

from minitouch_bench.metrics.definitions import METRICS
from tests.altered import ROOT

CODE_MAP = ROOT / "docs" / "project" / "code-map.md"
IN_CODE = re.compile(r"`(\w+(?:\.(?!(?:md|py|js|css|gif|csv|toml|txt|yml|json|cff)\b)\w+)?)`")
FOLDER = re.compile(r"`([a-z_]+/[a-z_]+/)`")
CONSTANT = re.compile(r"\b[A-Z][A-Z_]{3,}[A-Z]\b(?!\.)")


def defined_in(file):
    """Yield a module's name and package, and each name, or ``Class.field``, that it defines."""
    yield from (file.stem, *file.parent.parts)
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        match node:
            case ast.ClassDef(name=name, body=body):
                yield name
                fields = (one.target.id for one in body if isinstance(one, ast.AnnAssign))
                methods = (one.name for one in body if isinstance(one, ast.FunctionDef))
                yield from (f"{name}.{one}" for one in (*fields, *methods))
            case ast.FunctionDef(name=name) | ast.Name(id=name, ctx=ast.Store()):
                yield name


def test_every_name_in_the_code_map_exists():
    text = CODE_MAP.read_text(encoding="utf-8")
    named = {*IN_CODE.findall(text), *CONSTANT.findall(text)} - {"README", "Makefile"}
    files = (*ROOT.glob("minitouch_bench/**/*.py"), *ROOT.glob("experiments/**/*.py"))
    known = {name for file in files for name in defined_in(file)} | METRICS.keys()
    assert len(named) > 60
    assert named - known == set()
    folders = FOLDER.findall(text)
    assert folders
    places = (ROOT, ROOT / "minitouch_bench")
    assert [one for one in folders if not any((place / one).is_dir() for place in places)] == []
