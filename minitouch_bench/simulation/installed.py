"""What PyBullet brought along."""

from importlib.metadata import version
from pathlib import Path

import pybullet_data


def simulator_version() -> str:
    """Return the version of the installed PyBullet."""
    return version("pybullet")


def data_directory() -> Path:
    """Return where ``pybullet_data`` keeps its files."""
    return Path(pybullet_data.getDataPath())
