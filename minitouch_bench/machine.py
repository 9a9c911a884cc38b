"""Facts of this machine: its system, processor and Python; installed and optional packages."""

import importlib
import os
import platform
import re
import shlex
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from operator import attrgetter
from pathlib import Path
from types import ModuleType
from typing import Any

from minitouch_bench.episode import Count
from minitouch_bench.errors import MissingExtraError, PolicyLoadError

CPUINFO = Path("/proc/cpuinfo")
"""What Linux says of each processor, in lines of "name : value"."""

CONSTRAINTS = Path(__file__).parents[1] / "constraints.txt"
"""The versions that a clone was set up with; an installed package has no such file."""

OWN_ENVIRONMENT = {"lerobot": ", in an environment of its own with CPython 3.12 or 3.13"}
"""What is said of an extra that needs other versions than the rest."""


@dataclass(frozen=True)
class RunEnvironment:
    """Where and when a run was made; never part of its numbers.

    ``started`` and ``wall_s`` (seconds) are those of its last part where it was resumed.
    """

    packages: Mapping[str, str]
    machine: Mapping[str, str]
    workers: Count
    started: str
    wall_s: float


def machine_facts() -> dict[str, str]:
    """Return what a run records of the machine that it was made on."""
    return {
        "system": platform.platform(),
        "processor": processor_model(),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
    }


def processor_model() -> str:
    """Return the model of the processor, or its architecture where the system names no model."""
    return _processor_fact("model name") or platform.machine()


def processor_flags() -> frozenset[str]:
    """Return the processor's features, such as "avx512_bf16"; none where the system lists none."""
    return frozenset(_processor_fact("flags").split())


def _processor_fact(name: str) -> str:
    try:
        lines = CPUINFO.read_text(encoding="utf-8").splitlines()
    except OSError:  # macOS
        return ""
    facts = (line.partition(":") for line in lines)
    return next((value.strip() for key, _, value in facts if key.strip() == name), "")


def require(module: str, extra: str) -> ModuleType:
    """Import an optional module.

    Raises:
        MissingExtraError: it is not installed; the text names the extra that brings it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        wanted = " ".join(f"'{requirement}'" for requirement in extras()[extra])
        place = OWN_ENVIRONMENT.get(extra, "")
        # Otherwise pip takes versions that do not fit the clone's others.
        if CONSTRAINTS.exists() and not place:
            wanted += f" --constraint {shlex.quote(str(CONSTRAINTS))}"
        raise MissingExtraError(
            f"this needs the package '{error.name}': pip install {wanted} "
            f"(the extra minitouch-bench[{extra}]{place})"
        ) from error


def require_minari() -> ModuleType:
    """Import Minari; its HDF5 then uses no locks, which some file systems lack.

    Raises:
        MissingExtraError: it is not installed.
    """
    os.environ.setdefault("HDF5_USE_FILE_LOCKING", "FALSE")
    return require("minari", "data")


def installed_versions(names: Iterable[str]) -> dict[str, str]:
    """Return the versions of those of these packages that are installed."""
    versions = {}
    for name in names:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return versions


def compare_versions(there: Mapping[str, str], here: Mapping[str, str]) -> str:
    """Say which versions differ, as in "torch 2.6 there, 2.7 here"; "" where none does."""
    names = sorted({name for name, _ in there.items() ^ here.items()})
    return "; ".join(
        f"{name} {there.get(name, 'none')} there, {here.get(name, 'none')} here" for name in names
    )


def extras() -> dict[str, list[str]]:
    """Return the requirements of each extra; they work wherever this package came from."""
    requirements: dict[str, list[str]] = {}
    for line in requires("minitouch-bench") or ():
        requirement, _, marker = line.partition("; ")
        if extra := re.search("extra == ['\"](.+?)['\"]", marker):
            requirements.setdefault(extra[1], []).append(requirement)
    return requirements


def look_up_own(target: str) -> Any:
    """Return what the user names as ``package.module:attribute``, also in the working directory.

    Raises:
        PolicyLoadError: the module or the attribute does not exist.
    """
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # last, so that no file there shadows an installed package
    return look_up(target)


def look_up(target: str) -> Any:
    """Return the object named by ``package.module:attribute``.

    Raises:
        PolicyLoadError: the module or the attribute does not exist.
    """
    module_name, _, attribute = target.partition(":")
    try:
        return attrgetter(attribute)(importlib.import_module(module_name))
    except (ImportError, AttributeError) as error:
        # A module of this name may lie elsewhere, such as the user's own code.py beside Python's.
        file = getattr(sys.modules.get(module_name.partition(".")[0]), "__file__", None)
        place = f" ({file})" if file else ""
        raise PolicyLoadError(f"it cannot be imported: {error}{place}") from error
