"""A command's options as a TOML file: read in place of typing them, and written beside a run."""

import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from minitouch_bench.documents import write_toml
from minitouch_bench.errors import UsageError
from minitouch_bench.files import MIB, SETTINGS_FILE, os_errors_as, read_file, write_file

CONSENT = "trust"
"""The option that a file cannot set: only the command line can allow a policy to run code."""

Settings = Mapping[str, Any]


def read_settings(path: Path, names: Iterable[str]) -> dict[str, str | bool | list[str]]:
    """Return the options in a file by name; ``names`` are those that it may have.

    A hyphen in a name is an underscore. Numbers come back as the text that a user would type.

    Raises:
        UsageError: it is not readable, or an option does not exist or has no such value.
    """
    try:
        with os_errors_as(UsageError, path, "read"):
            table = tomllib.loads(read_file(path, MIB, follow=True).decode())
    except ValueError as error:
        raise UsageError(f"{path} cannot be read as TOML: {error}") from error
    known = {*names} - {CONSENT}
    found: dict[str, str | bool | list[str]] = {}
    for key, value in table.items():
        name = key.replace("-", "_")
        if name == CONSENT:
            raise UsageError(f"{path}: trust is given on the command line alone: add --trust")
        if name not in known:
            listed = ", ".join(sorted(known))
            raise UsageError(f"{path} has no use for '{key}'; its names are {listed}")
        found[name] = _as_typed(path, key, value)
    return found


def write_settings(settings: Settings, directory: Path) -> None:
    """Write the options of a run, none of which is None, into its directory.

    Raises:
        RunDirectoryError: the file cannot be written.
    """
    text = f"# minitouch-bench evaluate --config {SETTINGS_FILE}\n{write_toml(settings)}"
    write_file(directory / SETTINGS_FILE, text)


def _as_typed(path: Path, key: str, value: object) -> str | bool | list[str]:
    if isinstance(value, bool):
        return value
    if isinstance(value, list) and all(isinstance(one, str | int) for one in value):
        return [str(one) for one in value]
    if isinstance(value, str | int | float):
        return str(value)
    raise UsageError(f"{path}: '{key}' is no text, number, true or false, or list of them")
