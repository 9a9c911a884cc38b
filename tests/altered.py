"""What tests alter: JSON documents and actions."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from minitouch_bench.files import ACTIONS_FILE
from minitouch_bench.json_io import write_json

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


def edit_document(file: Path, change: Callable[[dict[str, Any]], object]) -> None:
    document = json.loads(file.read_text())
    change(document)
    file.write_bytes(write_json(document))


def swap(actions: dict[str, Any]) -> None:
    actions["opening/0"], actions["opening/1"] = actions["opening/1"], actions["opening/0"]


def nudge(actions: dict[str, Any]) -> None:
    actions["opening/1"][3, 0] = np.nextafter(actions["opening/1"][3, 0], np.float32(0))


def edit_actions(run: Path, change: Callable[[dict[str, Any]], object]) -> None:
    with np.load(run / ACTIONS_FILE) as archive:
        actions = dict(archive)
    change(actions)
    np.savez_compressed(run / ACTIONS_FILE, **actions)
