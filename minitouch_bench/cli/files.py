"""Text files that a command writes where its user asked for them."""

from pathlib import Path

from minitouch_bench.errors import RunDirectoryError


def write_text(file: Path, text: str, *, append: bool = False) -> None:
    """Write a file, or add to its end; its folder is made if need be.

    Raises:
        RunDirectoryError: it cannot be written.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("a" if append else "w", encoding="utf-8", newline="\n") as handle:
            handle.write(text)
    except OSError as error:
        raise RunDirectoryError(f"{file} cannot be written: {error.strerror}") from error
