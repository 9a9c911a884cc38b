"""The protocol's builds of PyBullet, and whether the installed one is known; it is not imported."""

import hashlib
import importlib.util
import sys
from collections.abc import Mapping
from pathlib import Path

from minitouch_bench.errors import UsageError
from minitouch_bench.machine import installed_versions
from minitouch_bench.protocol.minitouch import PROTOCOL

BUILDS = {"pybullet": "3.2.7", "pybullet-arm64": "3.2.8"}
"""Distributions of the protocol's simulator: the golden episodes are the same bits with both.

``pybullet`` has wheels for CPython 3.11, ``pybullet-arm64`` for later versions, also on x86-64.
"""

KNOWN_BUILDS: Mapping[str, Mapping[str, str]] = {
    "pybullet.cpython-311-x86_64-linux-gnu.so": {
        "6ef264fe07e719a39d4e058149da9c9e3d48febd0f53261de51400bc39a494dc": "pybullet",
        "a440bf18cf79c5b5a273e4b53915115122ef7f4789de51d752e51026a5119a3f": "pybullet-arm64",
    },
    "pybullet.cpython-312-x86_64-linux-gnu.so": {
        "b51bc0fe12f2db378e91974875e911428f7ee2f002d66c8533f1a3ef9b950cb5": "pybullet-arm64",
    },
    "pybullet.cpython-313-x86_64-linux-gnu.so": {
        "29d0e7d447f2484d0d9e99c695aaab9e6a5df5bf706459f084d99d485802f89a": "pybullet-arm64",
    },
    "pybullet.cpython-312-darwin.so": {
        "bd927e7ba44066fd8c82f2ea0f8686f883f3efe29eaec064d467d7275335c8f5": "pybullet-arm64",
    },
    "pybullet.cpython-313-darwin.so": {
        "c5d010a82177614c674a3855e3836bdeac85987bc9f41bdcb6ba54c96f56850e": "pybullet-arm64",
    },
}
"""SHA-256 of the library in each wheel of BUILDS, by its file name; and whose wheel it is."""


def advised_build() -> str:
    """Return what pip installs of the simulator on this Python."""
    name = "pybullet" if sys.version_info < (3, 12) else "pybullet-arm64"
    return f"{name}=={BUILDS[name]}"


def check_version() -> None:
    """Refuse another simulator than the protocol's, which gives other episodes.

    Raises:
        UsageError: another one is installed.
    """
    if not installed_versions(BUILDS).items() & BUILDS.items():
        raise UsageError(
            f"the protocol's simulator is {PROTOCOL.physics.simulator}, installed is another: "
            f"pip install {advised_build()}"
        )


def check_library() -> str:
    """Say which build the installed library is, by the table or by its own compilation.

    Raises:
        UsageError: there is none, or the table has its name with other content.
    """
    spec = importlib.util.find_spec("pybullet")
    if spec is None or spec.origin is None:
        raise UsageError(f"there is no simulator: pip install {advised_build()}")
    library = Path(spec.origin)
    known = KNOWN_BUILDS.get(library.name)
    if known is None:
        return f"{library.name} was compiled for this machine: no build is known to compare with"
    with library.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if digest not in known:
        raise UsageError(
            f"{library} is not a known build of the simulator (SHA-256 {digest[:12]}): pip install "
            f"--force-reinstall --no-deps --only-binary :all: {advised_build()}"
        )
    return f"{library.name} is the known build of {known[digest]}"


if __name__ == "__main__":
    try:
        check_library()
    except UsageError as error:
        sys.exit(str(error))
