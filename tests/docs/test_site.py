"""The documentation site builds without a warning, searches, and loads nothing from elsewhere."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.altered import ROOT

LOADED = re.compile(r"<(?:script|img|iframe|link)[^>]+(?:src|href)=\"?(https?:[^\">\s]+)")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_site_builds_and_opens_offline(tmp_path):
    pytest.importorskip("zensical", reason="pip install 'minitouch-bench[docs]'")
    shutil.copy(ROOT / "mkdocs.yml", tmp_path)  # the site is written beside it
    for name in ("docs", "examples"):
        shutil.copytree(ROOT / name, tmp_path / name)
    command = [Path(sys.executable).parent / "zensical", "build", "--strict"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) > 30
    assert not [found for page in pages for found in LOADED.findall(page.read_text())]
    search = json.loads((tmp_path / "site" / "search.json").read_text())
    assert any("sandbox" in entry["text"] for entry in search["items"])
