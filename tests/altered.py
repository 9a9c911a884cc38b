"""What tests alter: JSON documents and actions."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from minitouch_bench.json_io import write_json

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


def edit_document(file: Path, change: Callable[[dict[str, Any]], object]) -> None:
    document = json.loads(file.read_text())
    change(document)
    file.write_bytes(write_json(document))
