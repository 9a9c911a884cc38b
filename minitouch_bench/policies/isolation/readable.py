"""Which files a confined policy may read: what Python and its packages need to go on."""

import importlib.util
import os
import site
import sys
import sysconfig
from pathlib import Path

import minitouch_bench

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


def readable_paths() -> tuple[str, ...]:
    """Return the files and folders that every policy may read."""
    schemes = ("stdlib", "platstdlib", "purelib", "platlib")
    packages = [*(sysconfig.get_path(name) for name in schemes), *site.getsitepackages()]
    if site.ENABLE_USER_SITE:
        packages.append(site.getusersitepackages())
    # Another environment's packages, joined by a .pth file or PYTHONPATH.
    packages += [path for path in sys.path if Path(path).name in PACKAGE_FOLDERS]
    own = str(Path(minitouch_bench.__file__).parent)
    library = os.path.join(sys.base_prefix, "lib")  # with libpython, and conda's libraries
    return tuple(dict.fromkeys((*SYSTEM, library, *packages, own)))


def factory_paths(target: str) -> tuple[str, ...]:
    """Return what ``package.module:attribute`` may read beside: its code and its data.

    That is the working directory, every folder of ``sys.path``, and where its package lies if
    an editable installation put it elsewhere.
    """
    paths = [os.getcwd(), *(os.path.abspath(path) for path in sys.path if path)]
    try:
        spec = importlib.util.find_spec(target.partition(":")[0].partition(".")[0])
    except (ImportError, ValueError):
        spec = None
    if spec is not None:
        paths += spec.submodule_search_locations or [spec.origin or os.getcwd()]
    return tuple(dict.fromkeys(paths))
