"""Read ``run.json`` of a stranger: plain JSON in the one form that the program writes."""

import json
from typing import Any, NoReturn

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.records import SavedRun
from minitouch_bench.reporting.json_document import from_document

SHOWN = 40


def read_run_text(content: bytes, name: str) -> SavedRun:
    """Read a run from the bytes of its ``run.json``.

    Raises:
        RunDirectoryError: it is not JSON, holds NaN, infinity or a key twice, or is no run.
    """
    try:
        document = json.loads(
            content.decode(), parse_constant=_no_number, object_pairs_hook=_each_once
        )
    except (ValueError, RecursionError) as error:
        raise RunDirectoryError(f"it is not JSON: {error}") from error
    return from_document(document, name)


def _no_number(text: str) -> NoReturn:
    raise ValueError(f"{text} is no JSON number")


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) != len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {twice[:SHOWN]!a} is there twice")
    return members
