"""Write a text file as a whole."""

import os
from pathlib import Path

from minitouch_bench.errors import RunDirectoryError


def write_file(path: Path, text: str) -> None:
    """Write a file: a reader sees the old one or the new one, never a part.

    Raises:
        RunDirectoryError: it cannot be written.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(text, encoding="utf-8", newline="\n")
        os.replace(partial, path)
    except OSError as error:
        raise RunDirectoryError(f"{path} cannot be written: {error.strerror}") from error
