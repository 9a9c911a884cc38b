"""What a confined policy may read: the files and the variables that Python and packages need."""

import importlib.util
import os
import site
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import minitouch_bench
from minitouch_bench.errors import IsolationError
from minitouch_bench.files import RUN_ENTRIES
from minitouch_bench.processes import ARITHMETIC

SYSTEM = (
    "/lib", "/lib64", "/usr/lib", "/usr/lib64", "/usr/local/lib", "/usr/local/lib64",
    "/etc/ld.so.cache", "/etc/localtime", "/usr/share/zoneinfo", "/usr/share/locale",
    "/proc/cpuinfo", "/proc/meminfo", "/sys/devices/system/cpu", "/sys/devices/system/node",
    "/dev/zero", "/dev/urandom", "/dev/random",
)  # fmt: skip
"""The kernels of torch and onnxruntime choose themselves by what is said of the processor."""

PACKAGE_FOLDERS = ("site-packages", "dist-packages")
"""Names of folders that hold installed packages and nothing else."""

WRITABLE = ("/dev/null",)

HOST_SETTINGS = {**ARITHMETIC, "ORT_DISABLE_TELEMETRY": "1", "PYTHONHASHSEED": "0"}
"""Set in a host: no thread may exist before it forks, and no set may iterate by chance.

From 1.29 on, onnxruntime's Linux packages start a thread that reports models to Microsoft.
"""

KEPT_VARIABLES = frozenset({*HOST_SETTINGS, "LANG", "LC_ALL", "LC_CTYPE", "TZ"})
"""What a policy's process keeps of its environment."""

HOST_VARIABLES = KEPT_VARIABLES | {
    "PATH", "HOME", "LD_LIBRARY_PATH", "PYTHONPATH", "PYTHONHOME", "PYTHONPLATLIBDIR",
    "PYTHONWARNINGS", "VIRTUAL_ENV", "TMPDIR",
}  # fmt: skip
"""What the process it is forked from needs beside them, to start Python and import packages.

Keys and tokens of the user must not even be in its memory, which a policy inherits.
"""


def readable_paths() -> tuple[str, ...]:
    """Return the files and folders that every policy may read."""
    schemes = ("stdlib", "platstdlib", "purelib", "platlib")
    packages = [*(sysconfig.get_path(name) for name in schemes), *site.getsitepackages()]
    if site.ENABLE_USER_SITE:
        packages.append(site.getusersitepackages())
    # Another environment's packages, joined by a .pth file or PYTHONPATH.
    packages += [path for path in sys.path if Path(path).name in PACKAGE_FOLDERS]
    package = str(Path(minitouch_bench.__file__).parent)
    library = os.path.join(sys.base_prefix, "lib")  # with libpython, and conda's libraries
    return tuple(dict.fromkeys((*SYSTEM, library, *packages, package)))


class FactoryPaths(NamedTuple):
    """What a factory may read beside, and the folders whose entries' names it may list."""

    readable: tuple[str, ...]
    listable: tuple[str, ...]


NOTHING = FactoryPaths((), ())


def factory_paths(target: str, private: str = "") -> FactoryPaths:
    """Return what ``package.module:attribute`` may read beside: its code and its data.

    That is what lies in the working directory, in every folder of ``sys.path``, and where its
    package lies if an editable installation put it elsewhere. Hidden entries are left out, and
    the run's directory ``private``. What is made later cannot be read.

    Raises:
        IsolationError: one of these folders is the root folder or /etc.
    """
    folders = [os.getcwd(), *(path for path in sys.path if path)]
    try:
        spec = importlib.util.find_spec(target.partition(":")[0].partition(".")[0])
    except (ImportError, ValueError):
        spec = None
    if spec is not None:
        folders += spec.submodule_search_locations or [spec.origin or os.getcwd()]
    known = [Path(path).resolve() for path in readable_paths()]
    others = [
        path
        for path in dict.fromkeys(Path(folder).resolve() for folder in folders)
        if not any(path.is_relative_to(folder) for folder in known)
    ]
    for path in others:
        if Path("/etc").is_relative_to(path):
            raise IsolationError(
                f"a factory could read what lies in {path}, which is the working directory or on "
                "PYTHONPATH.\nRun the command in another directory"
            )
    run = Path(private).resolve() if private else None
    readable = [str(part) for path in others for part in _parts(path, run)]
    return FactoryPaths(tuple(readable), tuple(str(path) for path in others if path.is_dir()))


def _parts(path: Path, run: Path | None) -> Iterator[Path]:
    """Yield what may be read of a folder, or the path itself if it is none.

    A rule of Landlock holds for all that is below, so that a folder around what is left out
    cannot be named itself. A link opens nothing: what it points to is named or not.
    """
    if not path.is_dir():
        yield path
        return
    with suppress(PermissionError):
        for entry in sorted(path.iterdir()):
            is_of_run = entry == run or (path == run and entry.name in RUN_ENTRIES)
            if is_of_run or entry.name.startswith(".") or entry.is_symlink():
                continue
            if run is not None and run.is_relative_to(entry):
                yield from _parts(entry, run)
            else:
                yield entry


def forget_environment() -> None:
    """Leave nothing in the environment but what numbers depend on."""
    for name in set(os.environ) - KEPT_VARIABLES:
        del os.environ[name]
